from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from livlab.api.running import open_run
from livlab.config import builtin_experiments, load_experiment, parse_experiment, to_toml
from livlab.errors import ConfigError, InputError
from livlab.kinds.execute import execute
from livlab.kinds.optics.claims import crossing, peak
from livlab.kinds.optics.job import prepare, scattering
from livlab.runs.files import read_csv

HEAD = 'schema = 1\nkind = "optics"\nname = "small"\n[wavelengths]\nstart_nm = 500\nstop_nm = 600\nstep_nm = 20\n'
SPHERE = 'radii_um = [0.05]\n[[particle]]\nlabel = "glass"\nn_particle = 1.5\n'
BLOOD = '[[chromophore]]\nlabel = "blood"\ndataset = "haemoglobin_prahl"\ncolumn = "hbo2"\n'


def criterion(metric: str, of: str, reference: float = 0.0, **keys: object) -> str:
    lines = {"metric": metric, "of": of, "reference": reference, "tolerance": 0.01, **keys}
    return "[[criterion]]\n" + "".join(f"{k} = {json.dumps(v)}\n" for k, v in lines.items())


def spheres(more: str = "") -> str:
    return HEAD.replace("[wavelengths]", "radii_um = [0.05, 0.5]\n[wavelengths]") + SPHERE.partition("\n")[2] + more


@pytest.mark.parametrize("name", ["optics-mie-rayleigh", "optics-absorption"])
def test_the_experiments_that_come_with_livlab_pass_all_their_claims(name: str, tmp_path: Path) -> None:
    outcome = execute(load_experiment(builtin_experiments()[name]), base=tmp_path)
    assert outcome.claims
    assert [c["criterion"] for c in outcome.claims if c["verdict"] != "PASS"] == []
    assert outcome.report is not None
    page = outcome.report.read_text(encoding="utf-8")
    assert "<script" not in page
    for claim in outcome.claims:
        assert claim["criterion"].replace("&", "&amp;") in page
    with xr.open_dataset(outcome.folder / "result.nc", engine="h5netcdf") as result:
        assert result["wavelength"].attrs["units"] == "nm"
    assert len(read_csv(outcome.folder / "costs.csv")) == 2
    drawn = {p.stem for p in (outcome.folder / "figures").glob("*.svg")}
    wanted = {"absorption"} if "absorption" in name else {"phase", "phase-polar", "spectra", "efficiencies", "validity"}
    assert drawn == wanted
    main = open_run(outcome.folder).to_pandas()
    assert ("absorption_per_cm" if "absorption" in name else "q_sca_mie") in main.columns
    assert execute(load_experiment(builtin_experiments()[name]), base=tmp_path).cached


def test_claims_fail_where_the_physics_does(tmp_path: Path) -> None:
    """The claims of agreement, asked of the large sphere, fail; and a wrong printed value fails."""
    claims = "".join(
        criterion(metric, "glass", reference, radius_um=0.5)
        for metric, reference in (("pearson", 1.0), ("rmse", 0.0), ("log ratio", 0.0), ("phase rmse", 0.0))
    )
    printed = (
        '[[published]]\nlabel = "wrong"\nn_particle = 1.5\nradius_um = 0.5\nwavelength_nm = 500\n'
        'quantity = "q_sca"\nvalue = 2.0\ntolerance = 0.1\n'
    )
    outcome = execute(parse_experiment(spheres(claims + printed)), base=tmp_path, report=False)
    assert [c["verdict"] for c in outcome.claims] == ["FAIL"] * 5


def test_a_claim_that_cannot_be_judged_is_missing_with_its_reason(tmp_path: Path) -> None:
    text = HEAD + BLOOD + "haemoglobin_g_per_l = 150.0\n"
    text += criterion("peak", "blood", 550.0, band_nm=[540, 560])
    outcome = execute(parse_experiment(text), base=tmp_path, report=False)
    assert [c["verdict"] for c in outcome.claims] == ["MISSING"]
    notes = json.loads((outcome.folder / "manifest.json").read_text(encoding="utf-8"))["claim_notes"]
    assert "no peak" in next(iter(notes.values()))


def test_phase_functions_integrate_to_one_and_have_their_anisotropy() -> None:
    data = scattering(load_experiment(builtin_experiments()["optics-mie-rayleigh"]))  # type: ignore[arg-type]
    theta = data["theta"].to_numpy()
    for name in ("phase_mie", "phase_rayleigh"):
        curve = data[name] * np.sin(theta) * 2 * np.pi
        assert np.abs(curve.integrate("theta") - 1.0).max() < 2e-3
    turned = (data["phase_mie"] * np.sin(theta) * np.cos(theta) * 2 * np.pi).integrate("theta")
    assert np.abs(turned - data["phase_anisotropy"]).max() < 2e-3


def test_absorption_of_whole_blood_is_prahls() -> None:
    text = HEAD + BLOOD + "haemoglobin_g_per_l = 150.0\n"
    config = parse_experiment(text)
    prepare(config)  # type: ignore[arg-type]
    from livlab.kinds.optics.job import absorption

    data = absorption(config.chromophore, np.array([540.0, 576.0, 1200.0]))  # type: ignore[attr-defined]
    found = data["absorption"].sel(chromophore="blood").to_numpy()
    assert found[1] == pytest.approx(0.0053558 * 55540.0, rel=1e-4)  # ε of Prahl's table at 576 nm
    assert np.isnan(found[2])


def test_peak_and_crossing_refuse_what_is_not_there() -> None:
    x = np.arange(500.0, 601.0, 10.0)
    assert np.isnan(peak(x, x, (500, 600)))
    assert np.isnan(peak(x, np.full_like(x, np.nan), (500, 600)))
    assert np.isnan(crossing(x, x, (500, 600)))
    assert np.isnan(crossing(x, np.sin(x / 10), (500, 600)))
    assert crossing(x, x - 550, (500, 600)) == 550.0


def test_the_config_written_out_is_the_config() -> None:
    for name in ("optics-mie-rayleigh", "optics-absorption"):
        config = load_experiment(builtin_experiments()[name])
        assert parse_experiment(to_toml(config)) == config
        assert "criterion" in tomllib.loads(to_toml(config))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (HEAD, "particles or chromophores"),
        (spheres() + BLOOD, "particles or chromophores"),
        (spheres().replace("[0.05, 0.5]", "[0.5, 0.05]"), "must rise"),
        (spheres().replace("[0.05, 0.5]", "[]"), "goes with"),
        (spheres().replace("[0.05, 0.5]", "[90.0]").replace("500", "5").replace("600", "25"), "size parameter"),
        (spheres('[[particle]]\nlabel = "glass"\nn_particle = 1.4\n'), "twice"),
        (spheres(criterion("rmse", "glass")), "radius_um"),
        (
            spheres(criterion("rmse", "glas", radius_um=0.5)),
            "glass",
        ),
        (
            spheres(criterion("rmse", "glass", radius_um=0.3)),
            "must be one of",
        ),
        (
            spheres(
                '[[criterion]]\nmetric = "value"\nof = "glass"\nwavelength_nm = 550\nreference = 0\ntolerance = 1\n'
            ),
            "must be one of",
        ),
        (
            HEAD
            + BLOOD
            + '[[criterion]]\nmetric = "peak"\nof = "blood"\nband_nm = [400, 560]\nreference = 1\ntolerance = 1\n',
            "500–600",
        ),
    ],
)
def test_files_that_make_no_sense_are_refused(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        parse_experiment(text)


def test_a_molar_extinction_needs_its_concentration_and_an_absorption_none() -> None:
    with pytest.raises(InputError, match="haemoglobin_g_per_l"):
        prepare(parse_experiment(HEAD + BLOOD))  # type: ignore[arg-type]
    water = '[[chromophore]]\nlabel = "w"\ndataset = "water_pope_fry1997"\nhaemoglobin_g_per_l = 150.0\n'
    with pytest.raises(InputError, match="needs none"):
        prepare(parse_experiment(HEAD + water))  # type: ignore[arg-type]
