"""Studies that run: what is written, that it agrees with the solvers, that faults are told and kept work is kept."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from study_texts import BAND, BLOOD, MEAN, OXYGEN, READING, REFERENCE, RMSE, TISSUE, text

from livlab.acquire.instruments.solvers import AddingDoublingSolver
from livlab.acquire.instruments.spectrometer import measure
from livlab.config import parse_experiment
from livlab.errors import InputError, Interrupted
from livlab.jobs import jobs
from livlab.kinds.execute import execute
from livlab.metrics import normalise, rmse
from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.tissue import override
from livlab.runs.work import Silent


def run(source: str, base: Path, **options: Any) -> Path:
    """Run a study and return its folder."""
    return execute(parse_experiment(source), base=base, report=False, **options).folder


def notes(folder: Path) -> str:
    return "\n".join(json.loads((folder / "manifest.json").read_text())["notes"])


def test_a_grid_has_every_combination_and_the_solvers_own_numbers(tmp_path: Path) -> None:
    source = text("sweep", BLOOD, OXYGEN, REFERENCE, MEAN, RMSE)
    folder = run(source, tmp_path)
    table = pd.read_csv(folder / "results.csv")
    expected = list(itertools.product([0.01, 0.1**1.5, 0.1], [0.0, 1.0]))
    assert table[["blood", "oxygen"]].to_numpy() == pytest.approx(np.array(expected), rel=1e-8)
    config = parse_experiment(source)
    values = {"layers.pulp.elements.blood.fraction": 0.1**1.5, "layers.pulp.elements.blood.oxygenation": 1.0}
    stack = optical_stack(override(config.tissue.build(), values), config.reading, config.wavelengths.grid())  # type: ignore[attr-defined]
    own = measure(stack, config.instrument, AddingDoublingSolver(tolerance=1e-4))["value"].to_numpy()  # type: ignore[attr-defined]
    with xr.open_dataset(folder / "result.nc", engine="h5netcdf") as result:
        # Not the same to the last bit: linear algebra adds in an order that depends on the machine's load.
        assert result["reflectance"].isel(case=3).to_numpy() == pytest.approx(own, rel=1e-12)
        reference = result["reference"].isel(reference_name=0).to_numpy()
        assert result["factor_0"].attrs["path"] == "layers.pulp.elements.blood.fraction"
    assert table.loc[3, "mean"] == pytest.approx(own.mean(), rel=1e-8)
    again = rmse(normalise(own), normalise(reference))
    assert table.loc[3, "rmse vs human liver"] == pytest.approx(again, rel=1e-8)
    assert not list(folder.glob(".pieces/**/*.json"))


def test_designs_and_words_as_factors(tmp_path: Path) -> None:
    folder = run(text("sweep", BLOOD, READING, MEAN, '[sweep]\ndesign = "latin-hypercube"\npoints = 6'), tmp_path)
    table = pd.read_csv(folder / "results.csv")
    assert sorted(table["scatterer"]) == ["hepatocyte"] * 3 + ["published"] * 3
    assert table["blood"].between(0.01, 0.1).all()
    assert table["mean"].notna().all()
    means = table.groupby("scatterer")["mean"].mean()
    assert abs(means["hepatocyte"] - means["published"]) > 0.01


def test_the_instrument_can_vary(tmp_path: Path) -> None:
    factor = '[[factor]]\npath = "instrument.illumination_deg"\nvalues = [0.0, 60.0]\n'
    table = pd.read_csv(run(text("sweep", factor, MEAN), tmp_path) / "results.csv")
    assert table["mean"].iloc[0] != pytest.approx(table["mean"].iloc[1], rel=1e-3)


def test_sensitivity_finds_what_acts_and_says_what_does_not(tmp_path: Path) -> None:
    idle = '[[factor]]\nlabel = "idle"\npath = "layers.pulp.elements.cells.a_um"\nlow = 19.0\nhigh = 21.0\n'
    flat = '[[output]]\nmetric = "peak wavelength"\n'
    claim = '[[criterion]]\noutput = "mean"\nstatistic = "total"\nof = "blood"\nreference = 1.0\ntolerance = 0.1\n'
    undefined = claim.replace('"mean"', '"peak wavelength"')
    folder = run(text("sensitivity", BLOOD, idle, MEAN, flat, "[sensitivity]\npoints = 16", claim, undefined), tmp_path)
    found = pd.read_csv(folder / "indices.csv")
    last = found[found["points"] == 16].set_index("factor")
    # Published scattering stands in for the cells, so that their size does nothing at all.
    assert last.loc["idle", "total"] == 0.0
    assert last.loc["blood", "total"] > 0.9
    settled = pd.read_csv(folder / "settling.csv").set_index("output")
    assert settled.loc["peak wavelength", "verdict"] == "undefined"
    assert "is flat" in settled.loc["peak wavelength", "reason"]
    assert "Undefined indices: peak wavelength" in notes(folder)
    verdicts = pd.read_csv(folder / "claims.csv").set_index("criterion")["verdict"]
    assert verdicts["total of peak wavelength, blood"] == "MISSING"


def test_morris_ranks_blood_above_oxygen(tmp_path: Path) -> None:
    folder = run(text("sensitivity", BLOOD, OXYGEN, MEAN, '[sensitivity]\nestimator = "morris"\npoints = 8'), tmp_path)
    last = pd.read_csv(folder / "indices.csv").query("points == 8").set_index("factor")
    assert last.loc["blood", "mu"] < 0  # more blood, less light
    assert last.loc["blood", "mu_star"] > last.loc["oxygen", "mu_star"] > 0


def test_an_ablation_knows_what_changes_nothing(tmp_path: Path) -> None:
    wanted = '[ablation]\nbases = ["thesis"]\ntowards = "consistent"\n[[ablation.target]]\noutput = "mean"\n'
    folder = run(text("ablation", MEAN, wanted + "value = 0.3\ntolerance = 0.1"), tmp_path)
    table = pd.read_csv(folder / "ablation.csv").set_index("case")
    # No fibres here, so their options leave the scene as it is, exactly.
    same = table.loc["thesis, fibre_density cylinder"]
    assert same["same_as"] == "thesis"
    assert same["mean change"] == 0.0
    rate = table.loc["thesis, hepatocyte_rate linear"]
    assert pd.isna(rate["same_as"])
    assert abs(rate["mean change"]) > 1e-3
    assert rate["row"] == 9
    assert table.loc["thesis, published_scattering parsa1989", "same_as"] == "thesis"
    path = table[table["group"] == "path"]
    assert path["option"].tolist()[:2] == ["fibre_density", "elastin_index"]
    total = path["mean change"].sum()
    factor = '[[factor]]\npath = "reading.redirect_factor"\nvalues = ["none", "cos"]\n'
    alone = pd.read_csv(run(text("sweep", factor, MEAN, top='reading = "consistent"'), tmp_path) / "results.csv")
    assert table.loc["thesis", "mean"] + total == pytest.approx(alone["mean"].iloc[0], rel=1e-6)
    effects = table[table["group"] == "effect"]
    assert table.loc["thesis without blood", "mean change"] > 0.0  # without its absorber it is brighter
    assert table.loc["thesis without blood", "moves"] == "yes"
    assert (table.loc[table["same_as"].notna() & (table["group"] == "option"), "moves"] == "no").all()
    assert set(effects["option"]) >= {"blood", "surface-fresnel"}
    assert table["mean off"].to_numpy() == pytest.approx(np.abs(table["mean"] - 0.3) / 0.1, rel=1e-6)


def test_a_walk_agrees_with_adding_doubling_within_its_error(tmp_path: Path) -> None:
    exact = text("ablation", MEAN, '[ablation]\neffects = false\noptions = ["parenchyma_scattering"]')
    noisy = exact.replace('kind = "adding-doubling"\ntolerance = 1e-4', 'kind = "walk"\nsamples = 40000')
    a, b = (pd.read_csv(run(s, tmp_path / n) / "ablation.csv") for s, n in ((exact, "a"), (noisy, "b")))
    error = b["mean error"]
    assert (error > 0).all()
    assert (error < 0.01 * b["mean"]).all()  # the power to fail
    assert (np.abs(a["mean"] - b["mean"]) < 4 * error + 1e-4).all()


def test_a_ledger_agrees_with_adding_doubling(tmp_path: Path) -> None:
    exact = text("sweep", BLOOD, READING, MEAN)
    recorded = exact.replace('kind = "adding-doubling"\ntolerance = 1e-4', 'kind = "ledger"\nstandard_error = 0.002')
    a, b = (pd.read_csv(run(s, tmp_path / n) / "results.csv") for s, n in ((exact, "a"), (recorded, "b")))
    assert a["scatterer"].tolist() == b["scatterer"].tolist()
    assert np.abs(a["mean"] - b["mean"]).max() < 4 * 0.002
    assert np.ptp(a["mean"]) > 0.1


def test_points_that_fail_are_told_and_do_not_stop_the_rest(tmp_path: Path) -> None:
    """Each factor holds together alone; both at their upper ends fill more than there is room for."""
    more = '[tissue.inline.layers.elements.others]\nkind = "cell"\nfraction = 0.1\na_um = 9.0\n'
    more += "b_um = 9.0\nanisotropy = 0.9\n"
    tissue = TISSUE.replace("fraction = 0.8", "fraction = 0.1") + more
    pair = "".join(
        f'[[factor]]\npath = "layers.pulp.elements.{name}.fraction"\nvalues = [0.1, 0.85]\n'
        for name in ("cells", "others")
    )
    folder = run(text("sweep", pair, MEAN, tissue=tissue, top='reading = "consistent"'), tmp_path)
    table = pd.read_csv(folder / "results.csv")
    assert table["mean"].notna().tolist() == [True, True, True, False]
    assert "must sum to at most 1" in table["error"].iloc[3]
    assert "1 of 4 points are no tissue: they were not simulated" in notes(folder)
    assert "evaluations gave no curve" not in notes(folder)
    recorded = text("sweep", pair, MEAN, tissue=tissue, top='reading = "consistent"').replace(
        'kind = "adding-doubling"\ntolerance = 1e-4', 'kind = "ledger"\nstandard_error = 0.02'
    )
    same = pd.read_csv(run(recorded, tmp_path / "ledger") / "results.csv")
    assert same["mean"].notna().tolist() == [True, True, True, False]


def test_a_study_in_which_every_point_fails_says_why(tmp_path: Path) -> None:
    """Adding–doubling knows no lateral distance, which a fibre probe asks for."""
    camera = BAND[BAND.index("[instrument]") : BAND.index("[solver]")]
    probe = BAND.replace(camera, '[instrument]\nkind = "fibre-probe"\n\n')
    with pytest.raises(InputError, match=r"0 of 3 evaluations.*the first failed so.*lateral distance"):
        run(text("sweep", BLOOD, MEAN, band=probe), tmp_path)


def test_an_output_that_is_nan_everywhere_is_told_and_its_claims_are_missing(tmp_path: Path) -> None:
    nowhere = REFERENCE + '[[reference]]\nlabel = "lost"\ndataset = "nachabe2011_liver"\n'
    output = RMSE + '[[output]]\nmetric = "rmse"\nlabel = "off"\nagainst = "lost"\n'
    claim = '[[criterion]]\noutput = "off"\nstatistic = "least"\nreference = 0.0\ntolerance = 0.1\n'
    folder = run(text("sweep", BLOOD, nowhere, output, claim), tmp_path)
    table = pd.read_csv(folder / "results.csv")
    assert table["off"].isna().all()
    assert table["rmse vs human liver"].notna().all()
    assert "off:" in notes(folder)
    assert pd.read_csv(folder / "claims.csv")["verdict"].tolist() == ["MISSING"]


def test_a_study_that_was_stopped_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, done = text("sweep", BLOOD, OXYGEN, MEAN), []
    honest = jobs.run_job

    class Stopping(Silent):
        """Asks to stop after two answers, as Ctrl-C does."""

    def counted(job: jobs.Job) -> jobs.Answer:
        done.append(job.digest)
        if len(done) == 3:
            raise KeyboardInterrupt
        return honest(job)

    monkeypatch.setattr(jobs, "run_job", counted)
    with pytest.raises(Interrupted):
        run(source, tmp_path, progress=Stopping())
    monkeypatch.setattr(jobs, "run_job", lambda job: done.append(job.digest) or honest(job))
    folder = run(source, tmp_path)
    assert len(done) == 7  # the third was begun twice, and no other
    assert len(set(done)) == 6
    whole = run(source, tmp_path / "at once")
    drop = ["seconds"]
    assert (
        pd.read_csv(folder / "results.csv")
        .drop(columns=drop)
        .equals(pd.read_csv(whole / "results.csv").drop(columns=drop))
    )


def test_same_seed_same_numbers_another_seed_others(tmp_path: Path) -> None:
    source = text(
        "sweep", BLOOD, MEAN, band=BAND.replace('"adding-doubling"\ntolerance = 1e-4', '"walk"\nsamples = 2000')
    )
    a, b = (pd.read_csv(run(source, tmp_path / n) / "results.csv")["mean"] for n in "ab")
    other = pd.read_csv(run(source.replace("seed = 3", "seed = 4"), tmp_path) / "results.csv")["mean"]
    assert a.equals(b)
    assert (a != other).all()
