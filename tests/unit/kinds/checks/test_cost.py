"""What accuracy costs: slopes, fronts, sentences, figures, and the command."""

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from livlab.acquire.instruments.fibre_probe import FibreProbe
from livlab.acquire.instruments.integrating_sphere import IntegratingSphere
from livlab.cli import app
from livlab.errors import ConfigError, InputError
from livlab.kinds.checks import cost as study
from livlab.kinds.checks.cost import CostRow, cost, slope
from livlab.model.tissue.phase.functions import Isotropic
from livlab.model.tissue.stack import plain_stack
from livlab.reports.cost import cost_figure, run_figure, run_rows, sentence, shown_error

FILE = """\
schema = 1
name = "small"
readings = ["consistent"]
tissue = { variant = "parenchyma_only" }
wavelengths = { list_nm = [500, 700] }
instrument = { kind = "integrating-sphere", port_diameter_mm = "infinite" }
accuracy = { relative = 0.02 }
"""


def row(solver="walk expected", samples=1000, seconds=1.0, error=0.01, stated=0.01, **more):
    given = {"compile_seconds": 0.0, "trusted": True, "valid": True, "repeats": 1, "pareto": True}
    given |= {"reference": "adding-doubling", "reference_error": 1e-6} | more
    return CostRow(solver, samples, seconds, error=error, stated=stated, **given)


def tried(solver, seconds, off, stated, samples=0):
    return study._Tried(solver, samples, seconds, 0.0, np.full((1, 2), 0.5 + off), np.full(2, stated), valid=True)


def frame(rows):
    return pd.DataFrame([vars(r) for r in rows])


def test_slope_of_made_up_errors():
    rows = [row(samples=n, error=0.3 * n**-0.5, stated=0.3 * n**-0.5) for n in (1000, 4000, 16000, 64000)]
    fall, error = slope(rows, "walk expected")
    assert fall == pytest.approx(-0.5)
    x = np.log([r.samples for r in rows])
    assert error == pytest.approx(1 / math.sqrt(2 * np.sum((x - x.mean()) ** 2)))
    with pytest.raises(InputError, match="at least two"):
        slope(rows, "walk analog")
    with pytest.raises(InputError, match="at least two"):
        slope([rows[0], row(samples=4000, trusted=False)], "walk expected")


def test_the_front_is_what_nothing_beats():
    reference = tried("adding-doubling", 5.0, 0.0, 1e-6)
    made = study._rows(
        [
            tried("kubelka-munk", 0.1, 0.1, math.nan),
            tried("walk expected", 1.0, 0.01, 0.01, 1000),
            tried("walk analog", 2.0, 0.02, 0.02, 1000),
            reference,
        ],
        reference,
    )
    assert [r.pareto for r in made] == [True, True, False, True]
    assert [r.trusted for r in made] == [True, True, True, False]
    assert [round(r.error, 12) for r in made] == [0.1, 0.01, 0.02, 0.0]
    # Equal in both is beaten once.
    twins = study._rows([tried("a", 1.0, 0.1, 0.1), tried("b", 1.0, 0.1, 0.1), reference], reference)
    assert [r.pareto for r in twins] == [True, False, True]


def test_an_error_near_the_reference_s_own_is_not_trusted():
    reference = tried("walk expected", 5.0, 0.0, 1e-3, 10**6)
    made = study._rows([tried("walk analog", 1.0, 1e-4, 2e-3, 1000), reference], reference)
    assert not made[0].trusted
    assert shown_error(frame(made)).tolist() == pytest.approx([2e-3, 1e-3])


def test_a_sentence_says_what_the_next_digit_costs():
    rows = [
        row(samples=1000, seconds=0.05, error=0.04, stated=0.038),
        row(samples=10**6, seconds=4.8, error=0.0011, stated=0.0012),
        row("walk analog", samples=10**6, seconds=5.5, error=0.002, stated=0.0019),
        row("kubelka-munk", 0, 0.01, 0.05, math.nan, valid=False),
        row("adding-doubling", 0, 0.7, 0.0, 3e-7, trusted=False),
    ]
    said = sentence(frame(rows))
    assert "walk expected: an error of 0.0012 in 4.8 s; the next digit costs 100×: 8 min" in said
    assert "walk analog" not in said
    assert "adding-doubling: 3e-07 in 0.7 s, without noise" in said
    assert "kubelka-munk is off by 0.05 here however long it works" in said


def test_the_figure_shows_every_solver_the_front_and_the_slope():
    rows = [row(samples=1000 * 4**k, seconds=0.1 * 4**k, error=0.02 / 2**k, stated=0.02 / 2**k) for k in range(4)]
    rows += [row("kubelka-munk", 0, 0.01, 0.05, math.nan, valid=False)]
    rows += [row("adding-doubling", 0, 0.7, 0.0, 3e-7, trusted=False)]
    ax = cost_figure(frame(rows)).axes[0]
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    labels = [t.get_text() for t in ax.get_legend().get_texts()]
    assert "kubelka-munk (outside its domain)" in labels
    assert "adding-doubling, as it states" in labels
    assert "Pareto front" in labels
    lines = {line.get_label(): line.get_xydata() for line in ax.lines}
    fall = np.diff(np.log(lines["walk expected: slope −1/2"]), axis=0)[0]
    assert fall[1] / fall[0] == pytest.approx(-0.5)
    assert lines["walk expected: slope −1/2"][-1] == pytest.approx([640.0, 0.00025])
    # What is biased goes on level to the end.
    assert any(len(xy) == 2 and np.ptp(xy[:, 1]) == 0 and xy[1, 0] > 640 for xy in lines.values() if len(xy))
    points = lines["walk expected"]
    assert points[:, 1].tolist() == pytest.approx([0.02, 0.01, 0.005, 0.0025])


def test_a_run_s_rows_and_figure():
    costs = pd.DataFrame(
        [
            {"stage": "tissue", "reading": "a", "seconds": 0.1},
            {"stage": "measure", "reading": "a", "seconds": 4.8, "samples": 10**6, "solver": "walk expected",
             "error": 0.00123, "relative_error": 0.00456},
            {"stage": "measure", "reading": "b", "seconds": 0.3, "samples": 0, "solver": "adding-doubling",
             "error": 1.2e-6, "relative_error": 3e-6},
        ]
    )  # fmt: skip
    made = run_rows(costs)
    assert made["next digit"].tolist() == ["8 min", "no noise to lower"]
    assert made["largest error"].tolist() == ["0.0012", "1.2e-06"]
    convergence = pd.DataFrame({"reading": "a", "seconds": [1.0, 4.8], "samples": [1, 2], "error": [0.002, 0.001]})
    lines = [line.get_xydata() for line in run_figure(costs, convergence).axes[0].lines]
    assert any(np.allclose(xy, [[4.8, 0.001], [480.0, 0.0001]]) for xy in lines)


def test_a_budget_is_positive_and_what_cannot_answer_is_left_out(monkeypatch):
    slab = plain_stack([(1.4, 0.1, 5.0, 2.0, Isotropic())])
    with pytest.raises(InputError, match="budget"):
        cost(slab, IntegratingSphere(), budget_seconds=0.0)
    monkeypatch.setattr(study, "_walks", lambda *_: [])
    monkeypatch.setattr(study, "_ledgers", lambda *_: [])
    monkeypatch.setattr(study, "_longest", lambda *_: tried("walk expected", 1.0, 0.0, 1e-3, 1000))
    rows = cost(slab, FibreProbe(distance_mm=2.0), budget_seconds=1.0)
    assert [r.solver for r in rows] == ["walk expected"]


def test_the_command_writes_table_and_figures_and_the_report_shows_them(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text(FILE)
    ran = CliRunner().invoke(app, ["run", "small.toml"])
    assert ran.exit_code == 0
    page = Path(ran.output.strip().splitlines()[-1])
    before = page.read_text()
    assert "What each reading's accuracy cost" in before.replace("&#39;", "'")
    assert "Every solver on the scene" not in before
    done = CliRunner().invoke(app, ["cost", "small.toml", "--budget", "2"])
    assert done.exit_code == 0, done.output
    assert done.output.strip().splitlines()[-1] == str(page)
    assert "the next digit costs 100×" in " ".join(done.output.split())
    folder = page.parent
    assert (folder / "cost.png").read_bytes().startswith(b"\x89PNG")
    assert "<svg" in (folder / "cost.svg").read_text()
    table = pd.read_csv(folder / "cost.csv")
    assert set(table["reading"]) == {"consistent"}
    assert {"walk expected", "walk analog", "adding-doubling", "kubelka-munk"} <= set(table["solver"])
    assert (table["error"] >= 0).all()
    assert "Every solver on the scene of the consistent reading" in page.read_text()
    # The run is still found as it was.
    assert "Done before" in CliRunner().invoke(app, ["run", "small.toml"]).output


def test_the_command_names_the_readings_there_are(tmp_path):
    file = tmp_path / "small.toml"
    file.write_text(FILE)
    done = CliRunner().invoke(app, ["cost", str(file), "--reading", "thesis"])
    assert isinstance(done.exception, ConfigError)
    assert "It has consistent" in str(done.exception)
