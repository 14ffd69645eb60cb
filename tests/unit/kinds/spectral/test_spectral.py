"""The spectral job: what its folder says against the same numbers computed another way."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy import stats

from livlab import datasets
from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
from livlab.acquire.instruments.solvers import AddingDoublingSolver
from livlab.acquire.instruments.spectrometer import measure
from livlab.config import parse_experiment
from livlab.kinds.execute import Outcome, execute
from livlab.kinds.shared.seeds import reading_seed
from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import READINGS
from livlab.runs.files import read_csv
from livlab.runs.identity import read_manifest

CONFIG = """\
schema = 1
kind = "spectral"
name = "small"
readings = ["thesis", "consistent"]
tissue = { variant = "parenchyma_only" }
wavelengths = { start_nm = 500, stop_nm = 740, step_nm = 40 }
instrument = { kind = "hyperspectral-camera" }
solver = { kind = "adding-doubling", tolerance = 1e-3 }
[[reference]]
label = "human liver"
dataset = "liver_hsi_sellner2026"
column = "human_reflectance_share"
sd_column = "human_reflectance_share_sd"
subjects = 144
[[reference]]
label = "Nachabe 2011"
dataset = "nachabe2011_liver"
"""
CRITERIA = """
[[criterion]]
metric = "pearson"
against = "human liver"
reference = 1.0
tolerance = 0.5
[[criterion]]
metric = "rmse"
reading = "thesis"
against = "human liver"
reference = 0.0
tolerance = 0.5
on = "curve"
band_nm = [540, 700]
[[criterion]]
metric = "pearson"
reading = "thesis"
against = "Nachabe 2011"
reference = 0.97
tolerance = 0.03
[[criterion]]
metric = "energy residual"
reference = 0.0
tolerance = 1e-4
"""
GRID = np.arange(500.0, 741.0, 40.0)


def run(text: str, base: Path) -> Outcome:
    return execute(parse_experiment(text), base=base, report=False)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return run(CONFIG + CRITERIA, tmp_path_factory.mktemp("runs"))


@pytest.fixture(scope="module")
def result(done: Outcome) -> xr.Dataset:
    with xr.open_dataset(done.folder / "result.nc", engine="h5netcdf") as opened:
        return opened.load()


def claim(outcome: Outcome, name: str) -> dict[str, str]:
    (found,) = [c for c in outcome.claims if c["criterion"] == name]
    return found


def test_the_result_holds_what_the_instrument_measured(result: xr.Dataset) -> None:
    stack = optical_stack(load_preset("liver", variant="parenchyma_only"), READINGS["consistent"], GRID)
    direct = measure(stack, HyperspectralCamera(), AddingDoublingSolver(tolerance=1e-3))
    own = result.sel(reading="consistent")
    np.testing.assert_allclose(own["reflectance"], direct["value"], rtol=1e-12)
    np.testing.assert_allclose(own["diffuse_reflectance"], direct["reflectance"], rtol=1e-12)
    np.testing.assert_allclose(own["absorbed"].sel(layer="parenchyma"), direct["absorbed"].sel(layer="parenchyma"))
    assert (own["reflectance_se"] == 0).all()


def test_the_form_of_the_result_is_the_contract(result: xr.Dataset, done: Outcome) -> None:
    for name in ("reflectance", "specular", "transmittance", "lost", "residual", "redirect_loss"):
        assert result[name].dims == ("reading", "wavelength")
        assert result[f"{name}_se"].dims == ("reading", "wavelength")
    assert result["absorbed"].dims == ("reading", "layer", "wavelength")
    assert result["curve"].dims == result["curve_se"].dims == ("reading", "wavelength_curve")
    assert result["reference"].dims == result["reference_sd"].dims == ("reference_name", "wavelength_curve")
    assert result["reference_name"].values.tolist() == ["human liver"]
    assert {"units", "normalisation", "smoothing", "instrument", "samples", "seed", "variant"} <= set(result.attrs)
    with xr.open_dataset(done.folder / "result.nc", engine="h5netcdf", group="coefficients") as coefficients:
        for name in ("absorption", "scattering", "anisotropy"):
            assert coefficients[name].dims == ("reading", "layer", "element", "wavelength")
    assert (done.folder / "claims.csv").read_text().splitlines()[0] == (
        "criterion,value,standard_error,reference,tolerance,verdict,seconds,group,at_least,at_most,needs"
    )


def test_curves_and_references_are_scaled_to_their_maximum(result: xr.Dataset) -> None:
    np.testing.assert_allclose(result["curve"].max("wavelength_curve"), 1.0)
    grid = result["wavelength_curve"].to_numpy()
    np.testing.assert_allclose(grid, np.arange(500, 741, 5))
    table = datasets.load("liver_hsi_sellner2026")
    mean = table.interpolate("human_reflectance_share", grid)
    np.testing.assert_allclose(result["reference"][0], mean / mean.max())
    sd = table.interpolate("human_reflectance_share_sd", grid)
    np.testing.assert_allclose(result["reference_sd"][0], sd / mean.max())


def test_a_pearson_claim_is_scipys_of_the_points_in_the_table(done: Outcome) -> None:
    rows = [r for r in read_csv(done.folder / "spectra.csv") if r["reading"] == "consistent"]
    value = [float(r["reflectance"]) for r in rows]
    x = np.array([float(r["wavelength_nm"]) for r in rows])
    reference = datasets.load("liver_hsi_sellner2026").interpolate("human_reflectance_share", x)
    found = claim(done, "pearson consistent vs human liver 500-740")
    assert float(found["value"]) == pytest.approx(stats.pearsonr(value, reference).statistic, abs=1e-4)
    assert 0 < float(found["standard_error"]) < 0.01
    (row,) = [r for r in read_csv(done.folder / "metrics.csv") if r["criterion"] == found["criterion"]]
    assert int(row["points"]) == 7
    assert float(row["low_95"]) < float(row["value"]) < float(row["high_95"])


def test_an_rmse_claim_of_a_band_is_that_of_the_curve_scaled_within_it(done: Outcome, result: xr.Dataset) -> None:
    band = result.sel(reading="thesis", reference_name="human liver", wavelength_curve=slice(540, 700))
    a, b = (band[n].to_numpy() for n in ("curve", "reference"))
    wanted = np.sqrt(np.mean((a / a.max() - b / b.max()) ** 2))
    found = claim(done, "rmse thesis vs human liver 540-700, processed curve")
    assert float(found["value"]) == pytest.approx(wanted, abs=2 * float(found["standard_error"]))
    (row,) = [r for r in read_csv(done.folder / "metrics.csv") if r["criterion"] == found["criterion"]]
    assert float(row["value"]) == pytest.approx(wanted, rel=1e-6)


def test_the_light_adds_up(done: Outcome) -> None:
    for row in read_csv(done.folder / "budget.csv"):
        parts = [float(v) for k, v in row.items() if k not in ("reading", "wavelength_nm", "residual")]
        assert len(parts) == 6
        assert sum(parts) == pytest.approx(1.0 - float(row["residual"]), abs=1e-7)
    assert {c["verdict"] for c in done.claims if c["criterion"].startswith("energy")} == {"PASS"}


def test_a_reference_nobody_has_is_missing_and_says_why(done: Outcome) -> None:
    name = "pearson thesis vs Nachabe 2011 500-740"
    found = claim(done, name)
    assert found["verdict"] == "MISSING"
    assert found["value"] == found["standard_error"] == ""
    assert found["reference"] == "0.97"
    why = read_manifest(done.folder)["claim_notes"][name]
    assert "reference not available" in why
    assert "livlab data add" in why


META = """\
format = 1
name = "nachabe2011_liver"
version = "1"
title = "t"
source = "s"
kind = "digitised"
range_nm = [400.0, 900.0]
licence = "l"
read_in = "r"
sha256 = "{}"
uncertainty = {{ text = "u" }}
columns.wavelength_nm = {{ unit = "nm", description = "w" }}
columns.reflectance = {{ unit = "1", description = "r" }}
"""


def test_a_user_who_has_it_adds_it_and_the_claim_is_judged(
    done: Outcome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "data" / "nachabe2011_liver"
    folder.mkdir(parents=True)
    table = "wavelength_nm,reflectance\n400,0.1\n900,0.6\n"
    (folder / "table.csv").write_text(table)
    (folder / "meta.toml").write_text(META.format(hashlib.sha256(table.encode()).hexdigest()))
    monkeypatch.setenv("LIVLAB_DATA", str(tmp_path / "data"))
    again = run(CONFIG + CRITERIA, done.folder.parent)
    assert again.folder != done.folder
    found = claim(again, "pearson thesis vs Nachabe 2011 500-740")
    assert found["verdict"] in ("PASS", "FAIL")
    values = [float(r["reflectance"]) for r in read_csv(again.folder / "spectra.csv") if r["reading"] == "thesis"]
    assert float(found["value"]) == pytest.approx(stats.pearsonr(values, GRID).statistic, abs=1e-4)
    used = {r["name"]: r["used_for"] for r in read_csv(again.folder / "provenance.csv")}
    assert used["nachabe2011_liver"] == "reference: Nachabe 2011"


def test_provenance_names_what_was_drawn_on_and_nothing_else(done: Outcome) -> None:
    rows = read_csv(done.folder / "provenance.csv")
    assert {r["name"]: r["used_for"] for r in rows} == {
        "bile_nachabe2011": "bile of parenchyma",
        "haemoglobin_prahl": "blood of parenchyma",
        "lipid_vanveen2004": "lipid_and_water of parenchyma",
        "liver_hsi_sellner2026": "reference: human liver",
        "liver_refractive_index_giannios2016": "refractive index of parenchyma",
        "water_pope_fry1997": "lipid_and_water of parenchyma",
        "water_segelstein1981": "lipid_and_water of parenchyma",
    }
    for row in rows:
        assert row["sha256"] == datasets.load(row["name"]).meta.sha256
        assert row["source"]
        assert row["licence"]


def test_the_tables_hold_every_reading(done: Outcome) -> None:
    for name in ("spectra", "budget", "coefficients", "tissue"):
        assert {r["reading"] for r in read_csv(done.folder / f"{name}.csv")} == {"thesis", "consistent"}
    readings = {r["option"]: r for r in read_csv(done.folder / "readings.csv")}
    assert readings["hepatocyte_rate"]["thesis"] == "log10"
    assert readings["hepatocyte_rate"]["differs"] == "True"
    blood = {
        r["reading"]: r["value"]
        for r in read_csv(done.folder / "tissue.csv")
        if (r["element"], r["parameter"]) == ("blood", "fraction")
    }
    assert blood == {"thesis": "0.084", "consistent": "0.084"}
    costs = read_csv(done.folder / "costs.csv")
    stages = {(r["stage"], r["reading"]) for r in costs}
    assert stages == {("claims", "")} | {(s, r) for s in ("tissue", "measure") for r in ("thesis", "consistent")}


def test_a_black_tissue_has_no_curve_and_no_pearson_and_says_so(tmp_path: Path) -> None:
    black = CONFIG.replace(
        'tissue = { variant = "parenchyma_only" }',
        'tissue = { variant = "parenchyma_only", set = { "layers.parenchyma.elements.hepatocyte.fraction" = 0.0 } }',
    ).replace('polarisation = "none"', "")
    black = black.replace('"hyperspectral-camera"', '"hyperspectral-camera", polarisation = "crossed"')
    done = run(black + CRITERIA, tmp_path)
    found = claim(done, "pearson consistent vs human liver 500-740")
    assert found["verdict"] == "MISSING"
    assert read_manifest(done.folder)["claim_notes"][found["criterion"]]
    with xr.open_dataset(done.folder / "result.nc", engine="h5netcdf") as result:
        assert np.isnan(result["curve"]).all()
        np.testing.assert_allclose(result["reflectance"], 0.0, atol=1e-12)


def test_one_wavelength_is_enough(tmp_path: Path) -> None:
    one = CONFIG.replace("{ start_nm = 500, stop_nm = 740, step_nm = 40 }", "{ list_nm = [550] }")
    done = run(one + CRITERIA.replace("band_nm = [540, 700]", ""), tmp_path)
    assert claim(done, "pearson thesis vs human liver 550-550")["verdict"] == "MISSING"
    assert len(read_csv(done.folder / "spectra.csv")) == 2


def test_seeds_differ_between_readings_and_do_not_depend_on_the_others() -> None:
    seeds: dict[Any, int] = {
        (s, r): reading_seed(s, r) for s in range(50) for r in ("thesis", "consistent", "measured")
    }
    assert len(set(seeds.values())) == len(seeds)
    assert all(0 <= s < 2**31 for s in seeds.values())
