"""The notebook and the command line are two doors to the same numbers."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import livlab
from livlab.cli import app
from livlab.config import to_toml
from livlab.errors import ConfigError, InputError
from livlab.runs.compare import compare_file

TABLE = {
    "kind": "spectral",
    "name": "both",
    "readings": ["thesis", "measured"],
    "tissue": {"variant": "parenchyma_only"},
    "wavelengths": {"list_nm": np.array([500.0, 600.0, 700.0])},
    "instrument": {"kind": "collinear", "acceptance_deg": 90.0},
    "solver": {"kind": "walk", "samples": np.int64(20000), "pilot": 5000, "largest_launch": 15000},
    "processing": {"moving_average": 1, "interpolate_nm": 50.0},
    "criterion": ({"metric": "energy residual", "reference": 0.0, "tolerance": 1e-3},),
}
FIT = """\
schema = 1
kind = "fit"
name = "fit"
bench = false
[tissue]
preset = "skin"
[tissue.set]
"layers.epidermis.elements.baseline.fraction" = 0.8
[wavelengths]
start_nm = 500
stop_nm = 700
step_nm = 20
[instrument]
kind = "integrating-sphere"
sample_side_mm = "infinite"
port_diameter_mm = "infinite"
[search]
standard_error = 0.004
[[parameter]]
label = "melanosomes"
path = "layers.epidermis.elements.melanosomes.fraction"
low = 0.01
high = 0.19
[[parameter]]
label = "blood"
path = "layers.dermis.elements.blood.fraction"
low = 0.002
high = 0.01
transform = "log"
[[measurement]]
label = "mine"
dataset = "mine"
column = "reflectance"
scaling = "none"
"""


def call(*words: str) -> str:
    result = CliRunner().invoke(app, list(words))
    assert result.exit_code == 0, (result.output, result.exception)
    return result.output.strip().splitlines()[-1]


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory, libllvm: object) -> livlab.RunResult:
    return livlab.run(TABLE, out=tmp_path_factory.mktemp("api"), report=False)


def test_a_run_from_python_and_one_from_the_shell_are_one(ran: livlab.RunResult, tmp_path: Path) -> None:
    (tmp_path / "both.toml").write_text(to_toml(ran.experiment), encoding="utf-8")
    other = Path(call("run", str(tmp_path / "both.toml"), "--out", str(tmp_path / "out"), "--no-report", "--quiet"))
    assert other.name == ran.folder.name
    for name in ("result.nc", "spectra.csv", "curves.csv", "claims.csv", "budget.csv"):
        assert compare_file(name, other / name, ran.folder / name).same, name
    again = livlab.run(tmp_path / "both.toml", out=ran.folder.parent, report=False)
    assert again.cached
    assert again.folder == ran.folder


def test_a_run_is_read_as_it_was_written(ran: livlab.RunResult) -> None:
    assert ran.complete
    assert not ran.cached
    assert (ran.name, ran.kind) == ("both", "spectral")
    assert list(ran.spectra) == ["thesis", "measured"]
    frame = ran.to_pandas()
    for reading, spectrum in ran.spectra.items():
        rows = frame[frame["reading"] == reading]
        np.testing.assert_allclose(rows["reflectance"], spectrum.value, rtol=1e-8)
        np.testing.assert_allclose(rows["standard_error"], spectrum.standard_error, rtol=1e-8)
    assert len(ran.claims) == 2
    assert ran.claims.of("energy residual thesis vs conservation 500-700").verdict == "PASS"
    assert "spectra" in ran.tables
    assert ran.report is None
    assert ran.notes
    text = ran._repr_html_()
    assert "energy residual" in text
    assert repr(livlab.open_run(str(ran.folder))) == repr(ran)
    with pytest.raises(InputError, match="is none of run both") as told:
        ran.table("spectrum")
    assert "spectra" in told.value.remedy
    with pytest.raises(InputError, match="must be one of thesis, measured"):
        ran.spectrum()


def test_a_plot_of_a_run_holds_every_reading(ran: livlab.RunResult) -> None:
    from matplotlib.figure import Figure

    ax = ran.plot(Figure().subplots())
    assert [t.get_text() for t in ax.get_legend().get_texts()] == ["thesis", "measured"]


def test_a_run_from_python_can_be_done_again(ran: livlab.RunResult, tmp_path: Path) -> None:
    again = livlab.rerun(ran, out=tmp_path)
    assert again
    assert repr(again).startswith("<Again 'both': the same")
    assert "same but for times" in again._repr_html_()


def test_a_damaged_run_is_told_at_once(ran: livlab.RunResult, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(ran.folder, tmp_path / ran.folder.name))
    (folder / "config.toml").unlink()
    with pytest.raises(InputError, match=r"has no config\.toml"):
        livlab.open_run(folder)


@pytest.mark.parametrize("solver", ["walk", "adding-doubling"])
def test_a_spectrum_has_the_numbers_of_its_experiment(solver: str, tmp_path: Path, libllvm: object) -> None:
    rule = {"accuracy": 0.02} if solver == "walk" else {}
    own = livlab.spectrum("skin", "consistent", [500, 560, 620], state="dark", solver=solver, seed=7, **rule)  # type: ignore[arg-type]
    (tmp_path / "spectrum.toml").write_text(own.to_toml(), encoding="utf-8")
    folder = Path(call("run", str(tmp_path / "spectrum.toml"), "--out", str(tmp_path), "--no-report", "--quiet"))
    run = livlab.open_run(folder)
    np.testing.assert_array_equal(run.spectrum().value, own.value)
    np.testing.assert_array_equal(run.spectrum().standard_error, own.standard_error)
    assert run.manifest["seed"] == 7
    if solver == "walk":
        assert own.standard_error.max() <= 0.02 * own.value.max()
        other = livlab.spectrum(
            "skin", "consistent", [500, 560, 620], state="dark", solver=solver, seed=8, accuracy=0.02
        )
        assert (other.value != own.value).all()
        gap = np.abs(other.value - own.value) / np.hypot(own.standard_error, other.standard_error)
        assert (gap < 5).all()


def test_effects_left_out_are_said(libllvm: object) -> None:
    whole = livlab.spectrum("liver", "measured", [560, 640], accuracy=0.01)
    planned = livlab.spectrum("liver", "measured", [560, 640], accuracy=0.01, effects={"tolerance": 0.02})
    assert any(note.startswith("Left out ") for note in planned.notes)
    assert not any(note.startswith("Left out ") for note in whole.notes)
    assert np.abs(planned.value - whole.value).max() < 0.02 + 4 * np.hypot(
        planned.standard_error.max(), whole.standard_error.max()
    )


def test_a_fit_from_python_is_the_one_from_the_shell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, libllvm: object
) -> None:
    monkeypatch.setenv("LIVLAB_DATA", str(tmp_path / "data"))
    truth = {"layers.epidermis.elements.baseline.fraction": 0.8, "layers.epidermis.elements.melanosomes.fraction": 0.06,
             "layers.dermis.elements.blood.fraction": 0.006}  # fmt: skip
    seen = livlab.spectrum(
        "skin", "measured", range(500, 701, 20), changes=truth, solver="adding-doubling", name="mine"
    )
    seen.to_csv(tmp_path / "mine.csv")
    call("data", "add", str(tmp_path / "mine.csv"), "--name", "mine", "--source", "a test", "--kind", "assumed",
         "--unit", "1", "--yes")  # fmt: skip
    (tmp_path / "fit.toml").write_text(FIT, encoding="utf-8")
    run = livlab.open_run(call("run", str(tmp_path / "fit.toml"), "--out", str(tmp_path), "--no-report", "--quiet"))
    found = livlab.fit(
        livlab.reference("mine", name="mine"),
        {
            "layers.epidermis.elements.melanosomes.fraction": {"low": 0.01, "high": 0.19, "label": "melanosomes"},
            "layers.dermis.elements.blood.fraction": {
                "low": 0.002, "high": 0.01, "label": "blood", "transform": "log",
            },
        },
        tissue="skin",
        changes={"layers.epidermis.elements.baseline.fraction": 0.8},
        scaling="none",
        search={"standard_error": 0.004},
    )  # fmt: skip
    table = run.to_pandas().set_index("parameter")
    for column in ("value", "lower", "upper", "sd"):
        np.testing.assert_allclose(found.table[column], table[column], rtol=1e-7, err_msg=column)
    np.testing.assert_allclose(found.spectrum.value, run.spectra["fitted"].value, rtol=1e-9)
    for label, true in (("melanosomes", 0.06), ("blood", 0.006)):
        sd = found.table.loc[label, "sd"]  # of the recorded walk: an error of 5 % may be chance, three of these not
        assert sd < 0.1 * true
        assert abs(found.values[label] - true) <= 3.0 * sd
    assert found.tissue.layers[0].elements["melanosomes"].fraction == found.values["melanosomes"]  # type: ignore[union-attr]
    assert "melanosomes" in found._repr_html_()
    assert repr(found).startswith("<FitResult")
    assert found.scores.loc["mine", "rmse"] < 0.005
    from matplotlib.figure import Figure

    ax = Figure().subplots()
    assert found.plot(ax) is ax


def test_what_a_fit_cannot_do_is_refused_before_it_walks() -> None:
    curve = ([500, 600, 700], [0.1, 0.2, 0.3])
    path = "layers.dermis.elements.blood.fraction"
    with pytest.raises(ConfigError, match="high"):
        livlab.fit(curve, {path: (0.1, 0.01)}, tissue="skin")
    with pytest.raises(ConfigError, match="is no tissue at the start"):
        livlab.fit(curve, {"layers.dermis.elements.bloood.fraction": (0.01, 0.1)}, tissue="skin")
    with pytest.raises(ConfigError, match=r"must sum to at most 1"):
        livlab.fit(curve, {path: (0.01, 0.1)}, tissue="skin")
    with pytest.raises(InputError, match="chi2 needs"):
        livlab.fit(curve, {path: (0.001, 0.01)}, tissue="skin", loss="chi2")
    with pytest.raises(InputError, match="holds no curve"):
        livlab.fit({}, {path: (0.001, 0.01)}, tissue="skin")


def test_a_fit_whose_every_value_ends_at_its_bound_is_told_and_no_crash(libllvm: object) -> None:
    """More melanin than the box allows: nothing is left to have a covariance."""
    path = "layers.epidermis.elements.melanosomes.fraction"
    base = {"layers.epidermis.elements.baseline.fraction": 0.7}
    seen = livlab.spectrum(
        "skin", "measured", [500, 560, 620, 680], changes=base | {path: 0.3}, solver="adding-doubling"
    )
    found = livlab.fit(
        seen,
        {path: {"low": 0.01, "high": 0.1, "label": "melanosomes"}},
        tissue="skin",
        changes=base,
        scaling="none",
        search={"standard_error": 0.01},
    )
    assert found.values == {"melanosomes": 0.1}
    assert "bound" in found.table.loc["melanosomes", "status"]
    assert found.correlation.empty
    assert "bound" in found._repr_html_()
