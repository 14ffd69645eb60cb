"""Fits that are wrong are refused with field, value, bound and remedy before light is followed; good ones run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from study_texts import TISSUE

from livlab.config import load_experiment, parse_experiment
from livlab.errors import LivlabError
from livlab.kinds.execute import execute
from livlab.kinds.fit import job as fit_job
from livlab.kinds.fit import setup as fit_setup

HEAD = """
schema = 1
kind = "fit"
name = "small"
seed = 3
bench = false

[wavelengths]
start_nm = 520
stop_nm = 700
step_nm = 20

[instrument]
kind = "hyperspectral-camera"
illumination_deg = 0.0
acceptance_deg = 60.0

[search]
standard_error = 6e-3
"""

BLOOD = """
[[parameter]]
label = "blood"
path = "layers.pulp.elements.blood.fraction"
low = 0.01
high = 0.1
transform = "log"
"""

OXYGEN = """
[[parameter]]
label = "oxygen"
path = "layers.pulp.elements.blood.oxygenation"
low = 0.0
high = 1.0
"""

HUMAN = """
[[measurement]]
label = "human"
dataset = "liver_hsi_sellner2026"
column = "human_reflectance_share"
"""

RAT = HUMAN.replace('"human"', '"rat"').replace("human_", "rat_")


def source(*parts: str) -> str:
    return HEAD + TISSUE + "".join(parts)


def refused(text: str, *words: str) -> None:
    """Reading or preparing it fails and says all the words."""
    with pytest.raises(LivlabError) as caught:
        config = parse_experiment(text, source="a.toml")
        fit_job.prepare(config)  # type: ignore[arg-type]
    told = str(caught.value)
    for word in words:
        assert word in told, told
    assert caught.value.remedy


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (source(BLOOD.replace("0.01", "0.2"), HUMAN), ("blood", "0.2", "0.1", "low must not exceed high")),
        (source(BLOOD + "start = 0.5\n", HUMAN), ("blood", "0.5", "start must lie within [0.01, 0.1]")),
        (source(BLOOD.replace("0.01", "0.0").replace("high", "start = 0.0\nhigh"), HUMAN), ("log", "start at 0")),
        (source(BLOOD.replace("blood.fraction", "blod.fraction"), HUMAN), ("blod", "Did you mean 'blood'?")),
        (source(BLOOD, HUMAN.replace("human_refl", "human_rafl")), ("human_raflectance_share", "human_reflectance")),
        (source(BLOOD, HUMAN.replace("sellner2026", "selner2026")), ("liver_hsi_selner2026", "sellner2026")),
        (source(BLOOD, HUMAN + "band_nm = [525, 535]\n"), ("measurement human", "0 points", "2 or more")),
        (source(BLOOD, HUMAN + "band_nm = [515, 525]\n"), ("measurement human", "1 points", "2 or more", "Widen")),
        (source(BLOOD, HUMAN + "band_nm = [800, 900]\n"), ("band_nm", "lies outside 520–700 nm")),
        (source(BLOOD, HUMAN + "band_nm = [600, 550]\n"), ("band_nm", "must rise")),
        (source(BLOOD, HUMAN + 'loss = "chi2"\n'), ("chi2", "needs a standard deviation")),
        (source(BLOOD, HUMAN + "sd = 0.1\nrelative_sd = 0.1\n"), ("sd and relative_sd", "only one")),
        (
            source(BLOOD, HUMAN + 'loss = "colour"\n'),
            ("measurement human.loss", "17.7 % of white's luminance", "520–700 nm", "400–700 nm"),
        ),
        (source(BLOOD, HUMAN + 'role = "check"\n'), ("measurement.role", "none is to be fitted")),
        (source(BLOOD, BLOOD.replace('"blood"', '"twice"'), HUMAN), ("blood.fraction", "two parameters", "only = ")),
        (source(BLOOD + 'only = ["hamster"]\n', HUMAN), ("blood.only", "hamster", "names no measurement")),
        (source(OXYGEN + 'tied = "blud"\n', BLOOD, HUMAN), ("oxygen.tied", "blud", "Did you mean 'blood'?")),
        (
            source(BLOOD, HUMAN + 'set = {"layers.pulp.elements.blood.fraction" = 0.1}\n'),
            ("human.set", "is a parameter of this tissue"),
        ),
        (
            source(BLOOD, HUMAN + 'set = {"layers.pulp.elements.blood.fractoin" = 0.1}\n'),
            ("fractoin",),
        ),
        (source(BLOOD, HUMAN, "[round_trip]\ntissues = 5\n"), ("human.loss", "rmse", "no likelihood", "chi2")),
        (
            source(BLOOD, HUMAN, '[[criterion]]\nmetric = "coverage"\nreference = 0.95\ntolerance = 0.05\n'),
            ("coverage", "needs round trips"),
        ),
        (
            source(BLOOD, HUMAN).replace("standard_error = 6e-3", 'algorithm = ["GN_CRS3_LM"]'),
            ("GN_CRS3_LM", "GN_CRS2_LM"),
        ),
        (
            source(BLOOD, HUMAN).replace("standard_error = 6e-3", 'algorithm = ["auto", "LN_BOBYQA"]'),
            ("auto stands alone",),
        ),
    ],
)
def test_what_is_wrong_is_refused(text: str, words: tuple[str, ...]) -> None:
    refused(text, *words)


def test_a_reference_shorter_than_the_band_is_compared_where_it_is() -> None:
    # The human curve begins at 500 nm: of 440 to 700 nm the last eleven points are compared, and the scores say so.
    text = source(BLOOD, HUMAN).replace("start_nm = 520", "start_nm = 440")
    config = parse_experiment(text)
    measurement, grid = config.measurement[0], config.wavelengths.grid()  # type: ignore[attr-defined]
    found = fit_setup.target(measurement, fit_setup.MeasuredCurve.known(fit_job._load(measurement), grid), grid, 0, 1)
    assert found.size == 11
    refused(text.replace("stop_nm = 700", "stop_nm = 480"), "measurement human", "0 points")
    refused(text + "band_nm = [450, 600]\n", "human.band_nm", "beyond the curve, 500", "band_nm = [500, 600]")


def test_a_colour_over_a_wide_band_is_a_loss() -> None:
    # No liver curve here begins below 500 nm: the target is asked with a grid of its own.
    grid = np.arange(440.0, 721.0, 10.0)
    target = parse_experiment(source(BLOOD, HUMAN + 'loss = "colour"\n')).measurement[0]  # type: ignore[attr-defined]
    lab = fit_setup.colour_of(target, grid)
    assert lab is not None
    white = lab(np.ones(len(grid)))
    assert white == pytest.approx([100.0, 0.0, 0.0], abs=2.5)


def ran(text: str, base: Path, **options: Any) -> Path:
    return execute(parse_experiment(text), base=base, report=True, **options).folder


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two livers with blood in common, oxygen of their own, and one that is set."""
    text = source(
        BLOOD,
        OXYGEN.replace('"oxygen"', '"human oxygen"') + 'only = ["human"]\n',
        OXYGEN.replace('"oxygen"', '"rat oxygen"') + 'only = ["rat"]\n',
        HUMAN + "weight = 2.0\n",
        RAT + 'set = {"layers.pulp.elements.blood.vessel_radius_um" = 20.0}\nscaling = "sum"\nloss = "pearson"\n',
    )
    return ran(text, tmp_path_factory.mktemp("two"))


def test_parameters_of_one_measurement_and_of_all(two: Path) -> None:
    table = pd.read_csv(two / "fit.csv").set_index("parameter")
    assert list(table.index) == ["blood", "human oxygen", "rat oxygen"]
    assert table.loc["human oxygen", "path"] == table.loc["rat oxygen", "path"]
    assert abs(table.loc["human oxygen", "value"] - table.loc["rat oxygen", "value"]) > 1e-3
    scores = pd.read_csv(two / "scores.csv").set_index("measurement")
    assert (scores["rmse"] < 0.2).all()
    assert sorted(set(pd.read_csv(two / "recordings.csv")["scene"])) == [1, 2]


def test_each_scene_has_its_own_tissue(two: Path) -> None:
    # The stored curves are those of a forward model of one scene at the values found and set.
    with xr.open_dataset(two / "result.nc", engine="h5netcdf") as result:
        assert dict(result["reflectance"].sizes) == {"scene": 2, "wavelength": 10}
        both = result["reflectance"].to_numpy()
    config = load_experiment(two / "config.toml")
    values = pd.read_csv(two / "fit.csv").set_index("parameter")["value"]
    from livlab.acquire.instruments.solvers import AddingDoublingSolver
    from livlab.acquire.instruments.spectrometer import measure
    from livlab.model.tissue.optics import optical_stack
    from livlab.model.tissue.tissue import override

    at = "layers.pulp.elements.blood"
    for k, (who, radius) in enumerate((("human", 10.0), ("rat", 20.0))):
        changes = {
            f"{at}.fraction": values["blood"],
            f"{at}.oxygenation": values[f"{who} oxygen"],
            f"{at}.vessel_radius_um": radius,
        }
        stack = optical_stack(override(config.tissue.build(), changes), config.reading, config.wavelengths.grid())  # type: ignore[attr-defined]
        wanted = measure(stack, config.instrument, AddingDoublingSolver(tolerance=1e-4))["value"].to_numpy()  # type: ignore[attr-defined]
        np.testing.assert_allclose(both[k], wanted, atol=5 * 6e-3)
    assert np.abs(both[0] - both[1]).max() > 5e-3


def test_a_run_of_round_trips_counts_and_reports(tmp_path: Path) -> None:
    text = source(
        BLOOD,
        HUMAN + 'relative_sd = 0.02\nloss = "chi2"\nscaling = "free"\n',
        "[round_trip]\ntissues = 3\nstandard_error = 6e-3\n",
        '[[criterion]]\nmetric = "coverage"\nreference = 0.95\ntolerance = 0.95\n',
    )
    folder = ran(text, tmp_path)
    table = pd.read_csv(folder / "round_trip.csv")
    trips = pd.read_csv(folder / "round_trips.csv")
    assert len(trips) == 3
    assert trips["truth"].between(0.01, 0.1).all()
    assert len(set(trips["truth"])) == 3
    assert table.loc[0, "inside"] == trips["inside"].sum()
    claim = pd.read_csv(folder / "claims.csv").iloc[0]
    assert claim["criterion"] == "coverage of round trips"
    assert claim["value"] == pytest.approx(trips["inside"].mean())
    page = (folder / "report.html").read_text()
    assert "do the intervals hold the truth" in page
    assert json.loads((folder / "manifest.json").read_text())["kind"] == "fit"
