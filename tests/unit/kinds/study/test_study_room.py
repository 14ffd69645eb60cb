"""Points of studies that are no tissue: refused before light, or left out and told."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from study_texts import MEAN, text

from livlab.config import parse_experiment
from livlab.errors import LivlabError
from livlab.kinds.execute import execute
from livlab.kinds.study import job as study_job

SKIN = '[tissue]\npreset = "skin"\nvariant = "dermis_only"\n'
REST = '[tissue.set]\n"layers.dermis.rest" = "baseline"\n'


def factor(element: str, low: float, high: float, count: int = 3, key: str = "fraction") -> str:
    path = f"layers.dermis.elements.{element}.{key}"
    return f'[[factor]]\nlabel = "{element}"\npath = "{path}"\nlow = {low}\nhigh = {high}\ncount = {count}\n'


def refused(source: str, *words: str) -> None:
    with pytest.raises(LivlabError) as caught:
        study_job.prepare(parse_experiment(source))  # type: ignore[arg-type]
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize("method", ["sweep", "sensitivity"])
def test_a_bound_that_no_tissue_has_is_refused_with_its_limit(method):
    source = text(method, factor("blood", 0.001, 0.1), MEAN, tissue=SKIN)
    refused(source, "factor blood.high = 0.1", "no tissue above blood = 0.01,", "fractions of dermis = 1.09",
            "Give high = 0.01 or", "layers.dermis.rest = 'baseline'")  # fmt: skip


def test_a_bound_that_another_factor_makes_room_for_is_no_slip():
    """0.3 of blood does not fit beside the preset's 0.99 of baseline, and does beside what the study has."""
    pair = factor("blood", 0.1, 0.3) + factor("baseline", 0.5, 0.7)
    assert study_job.prepare(parse_experiment(text("sweep", pair, MEAN, tissue=SKIN)))  # type: ignore[arg-type]


def test_the_rest_makes_room(tmp_path: Path):
    source = text("sweep", factor("blood", 0.01, 0.4), MEAN, tissue=SKIN + REST)
    folder = execute(parse_experiment(source), base=tmp_path, report=False).folder
    table = pd.read_csv(folder / "results.csv")
    assert table["mean"].notna().all()
    assert (np.diff(table["mean"]) < 0).all()


def test_a_sensitivity_that_would_lose_too_many_blocks_is_refused_before_light():
    pair = factor("blood", 0.01, 0.5) + factor("baseline", 0.3, 0.9)
    source = text("sensitivity", pair, MEAN, "[sensitivity]\npoints = 16\n", tissue=SKIN)
    refused(source, "of 16 blocks", "no tissue", "fractions of dermis", "Narrow the factors")


def test_a_sensitivity_with_a_corner_cut_off_goes_on(tmp_path: Path):
    pair = factor("blood", 0.01, 0.2) + factor("baseline", 0.3, 0.9)
    source = text("sensitivity", pair, MEAN, "[sensitivity]\npoints = 16\nresamples = 50\n", tissue=SKIN)
    folder = execute(parse_experiment(source), base=tmp_path, report=False).folder
    table = pd.read_csv(folder / "results.csv")
    gone = table["blood"] + table["baseline"] > 1.0
    assert table["mean"].isna().tolist() == gone.tolist()
    assert 1 <= gone.sum() <= 2
    found = pd.read_csv(folder / "indices.csv")
    assert found["total"].notna().all()


def test_a_sweep_of_nothing_is_refused():
    grid = '[[factor]]\npath = "layers.dermis.elements.blood.fraction"\nvalues = [0.02, 0.03]\n'
    refused(text("sweep", grid, MEAN, tissue=SKIN), "0.02", "does not fit", "fractions of dermis")
