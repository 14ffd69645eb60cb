"""The jobs that check livlab itself: a claim a hard case, and claims of the ladder."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from livlab.api.running import open_run
from livlab.config import parse_experiment
from livlab.kinds.checks.config import StressExperiment
from livlab.kinds.checks.cost import CostRow
from livlab.kinds.checks.job import case_claims, ladder_claims
from livlab.kinds.execute import execute
from livlab.runs.files import read_csv
from livlab.stress.run import Line

LINE = Line("fresnel/normal", "r", "light along the normal", 0.04, 0.0, 0.04, 1e-9, "PASS", 0.1, "", "closed form")
ROW = CostRow("walk expected", 1000, 0.1, 0.5, 0.01, 0.008, True, True, 4, True, "adding-doubling", 1e-6)
TEXT = 'schema = 1\nkind = "stress"\nname = "few"\nonly = "fresnel/*"\n'


def test_a_case_passes_if_all_of_its_checks_do() -> None:
    good, bad = LINE, replace(LINE, quantity="t", verdict="FAIL")
    (claim,) = case_claims([good])
    assert (claim.verdict, claim.value, claim.criterion) == ("PASS", 0.0, "checks that fail: fresnel/normal")
    (claim,) = case_claims([good, bad])
    assert (claim.verdict, claim.value) == ("FAIL", 1.0)
    (claim,) = case_claims([good, replace(good, verdict="MISSING", note="no libLLVM")])
    assert (claim.verdict, claim.note) == ("MISSING", "no libLLVM")


def test_a_run_of_hard_cases_is_a_run_like_any_other(tmp_path: Path) -> None:
    config = parse_experiment(TEXT)
    done = execute(config, base=tmp_path)
    assert done.claims
    assert {c["verdict"] for c in done.claims} == {"PASS"}
    assert all("fresnel/" in c["criterion"] for c in done.claims)
    assert done.report is not None
    assert "Hard cases" in done.report.read_text(encoding="utf-8")
    assert list(open_run(done.folder).to_pandas()["criterion"]) == [
        r["criterion"] for r in read_csv(done.folder / "stress.csv")
    ]
    assert execute(config, base=tmp_path).cached
    resolved = config.resolve()
    assert isinstance(resolved, StressExperiment)
    assert len(resolved.catalogue) == 64
    assert resolved.resolve() == resolved


def test_the_ladder_is_held_against_what_its_solvers_state() -> None:
    rows = [
        ROW,
        replace(ROW, samples=4000, error=0.005, stated=0.004),
        replace(ROW, samples=16000, error=0.0025, stated=0.002),
        replace(ROW, solver="diffusion", samples=0, valid=False, notes="too much absorption"),
        replace(ROW, solver="kubelka-munk", samples=0, error=0.5, stated=0.1),
        replace(ROW, solver="adding-doubling", samples=0, trusted=False, stated=math.nan),
    ]
    claims = {c.criterion: c for c in ladder_claims(rows, 3.0)}
    walk = claims["largest error over what it states: walk expected"]
    assert (walk.verdict, walk.value) == ("PASS", 1.25)
    assert claims["largest error over what it states: kubelka-munk"].verdict == "FAIL"
    assert "too much absorption" in claims["largest error over what it states: diffusion"].note
    assert claims["largest error over what it states: adding-doubling"].verdict == "MISSING"
    slope = claims["slope of ln error over ln samples: walk expected"]
    assert slope.value is not None
    assert abs(slope.value + 0.5) < 0.02
    (lone,) = [c for c in ladder_claims(rows[:1], 3.0) if c.criterion.startswith("slope")]
    assert lone.verdict == "MISSING"


def test_a_ladder_runs_from_its_file_to_its_report(tmp_path: Path) -> None:
    text = (
        'schema = 1\nkind = "ladder"\nname = "solvers"\nbudget_seconds = 1.0\n[tissue]\npreset = "liver"\n'
        'variant = "parenchyma_only"\n[wavelengths]\nlist_nm = [600.0]\n'
        '[tissue.set]\n"layers.parenchyma.thickness_mm" = inf\n'
    )
    done = execute(parse_experiment(text), base=tmp_path)
    assert {"solver", "error", "stated"} <= set(open_run(done.folder).to_pandas().columns)
    assert any(c["criterion"] == "largest error over what it states: walk expected" for c in done.claims)
    assert done.report is not None
    assert (done.folder / "figures" / "cost-of-every-solver.svg").is_file()
