"""Factors that move nothing are told, against differences that are set by hand; those that move something are not."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from study_texts import MEAN, text

from livlab.config import parse_experiment
from livlab.kinds.execute import execute
from livlab.kinds.study.config_parts import Factor
from livlab.kinds.study.idle import move, moves
from livlab.kinds.study.outputs import Number
from livlab.model.tissue.limits import limits_of
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import READINGS

A, B = Factor(path="a.x", low=0.0, high=1.0), Factor(path="b.x", low=0.0, high=1.0)
GRID = [{"a.x": x, "b.x": y} for x in (0.0, 0.5, 1.0) for y in (0.0, 0.25, 0.5, 1.0)]


def told(make, sd=0.0, rng=None, points=GRID, metric="mean"):
    numbers = [Number(make(p) + (rng.normal(0.0, sd) if rng is not None else 0.0), sd) for p in points]
    found = moves((A, B), {"y": metric}, points, [{"y": n} for n in numbers])
    return {name: all(m.none for m in ms) for name, ms in found.items()}


@pytest.mark.parametrize(
    ("effect", "none"), [(0.0, True), (3e-5, True), (0.9e-3, True), (1.1e-3, False), (0.1, False), (-0.1, False)]
)
def test_without_noise_a_thousandth_of_the_level_counts(effect, none):
    assert told(lambda p: 1.0 - abs(effect) + effect * p["a.x"] + 0.2 * p["b.x"] * 0)["a x"] == none


def test_an_effect_that_only_an_interaction_has_is_an_effect():
    assert told(lambda p: 0.4 + 0.01 * p["a.x"] * p["b.x"]) == {"a x": False, "b x": False}
    assert told(lambda p: 0.4 + 0.01 * (p["a.x"] - 0.5) ** 2) == {"a x": False, "b x": True}


def test_chance_alone_seldom_looks_like_an_effect_and_an_effect_seldom_like_chance():
    rng = np.random.default_rng(11)
    draws, sd = 400, 0.01
    alarms = sum(not told(lambda p: 0.4, sd, rng)["a x"] for _ in range(draws))
    assert alarms <= 0.05 * draws + 2 * np.sqrt(0.05 * 0.95 * draws)
    missed = sum(told(lambda p: 0.4 + 6 * np.sqrt(2) * sd * p["a.x"], sd, rng)["a x"] for _ in range(100))
    assert missed <= 5


def test_a_correlation_moves_by_its_distance_from_one():
    assert told(lambda p: 0.999 + 5e-4 * p["a.x"], metric="pearson")["a x"] is False
    assert told(lambda p: 0.999 + 5e-4 * p["a.x"], metric="mean")["a x"] is True


def test_what_cannot_be_compared_is_not_told():
    nothing = [{"y": Number(np.nan, np.nan)} for _ in GRID]
    assert move("y", "mean", nothing, [[0, 1]]) is None
    apart = [{"a.x": 0.1 * k, "b.x": 0.2 * k} for k in range(4)]
    assert moves((A, B), {"y": "mean"}, apart, [{"y": Number(1.0)}] * 4) == {"a x": [], "b x": []}


LIVER, SKIN = load_preset("liver"), load_preset("skin")
CELLS = "layers.parenchyma.elements."


@pytest.mark.parametrize(
    ("tissue", "path", "reading", "words"),
    [
        (LIVER, CELLS + "lipid_and_water.parts.lipid.share", "measured", "lipid only absorbs.*adds no droplets"),
        (LIVER, CELLS + "lipid_and_water.fraction", "measured", "lipid and water only absorbs"),
        (LIVER, CELLS + "blood.fraction", "measured", "blood only absorbs"),
        (LIVER, CELLS + "hepatocyte.albedo", "measured", "does without hepatocyte, for which published stands in"),
        (LIVER, CELLS + "published.anisotropy", "consistent", "does without published, for which hepatocyte stands in"),
        (LIVER, CELLS + "published.anisotropy", "measured", "µs' of published is given and kept"),
        (LIVER, "layers.capsule.elements.collagen.volume_fraction", "measured", "profile of capsule gives collagen"),
        (SKIN, "layers.1.elements.structure.anisotropy", "measured", "µs' of structure"),
        (SKIN, "layers.dermis.elements.structure.a_per_cm", "measured", None),
        (LIVER, CELLS + "hepatocyte.fraction", "consistent", None),
        (LIVER, "layers.parenchyma.thickness_mm", "measured", None),
        (LIVER, "layers.nowhere.elements.blood.fraction", "measured", None),
    ],
)
def test_elements_and_readings_say_what_a_value_does_not_do(tissue, path, reading, words):
    import re

    said = " ".join(limits_of(tissue, path, READINGS[reading]))
    assert re.search(words, said) if words else said == ""


FAT = """
[[factor]]
label = "fat"
path = "layers.parenchyma.elements.lipid_and_water.parts.lipid.share"
low = 0.0
high = 0.4
count = 2

[[factor]]
label = "blood"
path = "layers.parenchyma.elements.blood.fraction"
low = 0.01
high = 0.1
count = 2
"""


@pytest.mark.parametrize(
    ("method", "more", "points"),
    [
        ("sweep", "", 4),
        ("sweep", '[sweep]\ndesign = "latin-hypercube"\npoints = 3\n', 3),
        ("sensitivity", '[sensitivity]\nestimator = "morris"\npoints = 2\nresamples = 50\n', 6),
    ],
)
def test_fat_that_only_absorbs_is_told_in_every_study(tmp_path: Path, method, more, points):
    tissue = '[tissue]\npreset = "liver"\nvariant = "parenchyma_only"\n'
    tissue += '[tissue.set]\n"layers.parenchyma.thickness_mm" = inf\n'
    source = text(method, FAT, MEAN, more, tissue=tissue)
    source = source.replace("start_nm = 520\nstop_nm = 700\nstep_nm = 60", "list_nm = [650]")
    folder = execute(parse_experiment(source), base=tmp_path).folder
    factors = pd.read_csv(folder / "factors.csv").set_index("factor")
    assert factors["moves"].to_dict() == {"fat": "no", "blood": "yes"}
    assert factors.loc["fat", "largest_move"] < 1e-3 < factors.loc["blood", "largest_move"]
    assert len(pd.read_csv(folder / "results.csv")) == points
    said = " ".join(json.loads((folder / "manifest.json").read_text(encoding="utf-8"))["notes"])
    page = (folder / "report.html").read_text(encoding="utf-8")
    for place in (said, page, str(factors.loc["fat", "told"])):
        assert "fat moves no output over 0 to 0.4" in place
        assert "lipid only absorbs and does not scatter: a larger share of it adds no droplets" in place
