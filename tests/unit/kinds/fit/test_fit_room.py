"""Fractions that pass 1 within a fit's bounds: refused before light, or kept out of, and told."""

import numpy as np
import pytest

import livlab
from livlab.errors import LivlabError
from livlab.fitting.forward import LedgerForward

GRID = np.arange(500.0, 701.0, 20.0)
BLOOD = "layers.dermis.elements.blood.fraction"
OXYGEN = "layers.dermis.elements.blood.oxygenation"
LIVER = "layers.parenchyma.elements."
CURVE = (GRID, np.linspace(0.2, 0.6, len(GRID)))


@pytest.fixture
def dark(monkeypatch):
    """No light may be followed."""

    def record(*_args, **_kwargs):
        raise AssertionError("light was followed")

    monkeypatch.setattr(LedgerForward, "record_stacks", record)


@pytest.mark.parametrize(
    ("tissue", "parameters", "words"),
    [
        (
            "skin",
            {BLOOD: (0.001, 0.05, 0.005), OXYGEN: (0.0, 1.0)},
            ("parameter blood fraction.high = 0.05", "no tissue above blood fraction = 0.01,",
             "fractions of dermis = 1.04", "Give high = 0.01 or", "layers.dermis.rest = 'baseline'"),
        ),
        ("skin", {BLOOD: (0.001, 0.05)}, ("blood fraction.high = 0.05", "above blood fraction = 0.01,", "rest")),
        (
            "skin",
            {"layers.epidermis.elements.melanosomes.fraction": (0.01, 0.43, 0.02)},
            ("melanosomes fraction.high = 0.43", "above melanosomes fraction = 0.04", "fractions of epidermis = 1.39"),
        ),
        ("skin", {OXYGEN: (0.0, 1.2)}, ("blood oxygenation.high = 1.2", "above blood oxygenation = 1,")),
        (
            "liver",
            {LIVER + "blood.fraction": (0.01, 0.1), LIVER + "bile.fraction": (0.0, 0.3, 0.03)},
            ("bile fraction.high = 0.3", "above bile fraction = 0.211", "rest = 'lipid_and_water'"),
        ),
        (
            "liver",
            {LIVER + "lipid_and_water.parts.lipid.share": (0.0, 1.5, 0.1)},
            ("lipid share.high = 1.5", "above lipid share = 1,"),
        ),
        (  # each end can be reached beside some value of the other, but not from the middle of both
            "liver",
            {
                LIVER + "blood.fraction": (0.05, 0.5),
                LIVER + "lipid_and_water.fraction": (0.3, 0.65),
                LIVER + "bile.fraction": (0.05, 0.5),
            },
            ("start = ", "no tissue at the start (the middle of its bounds", "fractions of parenchyma", "Give start ="),
        ),
    ],
)  # fmt: skip
def test_bounds_that_hold_no_tissue_are_refused_before_light(dark, tissue, parameters, words):
    with pytest.raises(LivlabError) as caught:
        livlab.fit(CURVE, parameters, tissue=tissue)
    for word in words:
        assert word in str(caught.value)


def test_the_rest_lets_blood_pass_what_the_preset_has():
    rest = {"layers.dermis.rest": "baseline"}
    truth = livlab.spectrum("skin", "measured", GRID, changes={**rest, BLOOD: 0.03}, solver="adding-doubling")
    rng = np.random.default_rng(3)
    noisy = livlab.Spectrum(GRID, truth.value * (1 + 0.01 * rng.standard_normal(len(GRID))), 0.01 * truth.value)
    found = livlab.fit(noisy, {BLOOD: (0.001, 0.08)}, tissue="skin", changes=rest, loss="chi2", scaling="none",
                       search={"standard_error": 3e-3, "most_recordings": 2})  # fmt: skip
    row = found.table.loc["blood fraction"]
    assert row["lower"] < 0.03 < row["upper"] < 0.04
    assert found.tissue.layers[1].elements["baseline"].share == pytest.approx(1.0 - row["value"])


def test_a_box_that_is_partly_no_tissue_is_searched_and_told():
    """A third of the box is cut off: the truth lies near the wall, and a start from which the search runs into it."""
    base = {LIVER + "lipid_and_water.fraction": 0.6, "layers.parenchyma.thickness_mm": float("inf")}
    blood, bile = LIVER + "blood.fraction", LIVER + "bile.fraction"
    truth = livlab.spectrum("liver", "measured", GRID, changes={**base, blood: 0.11, bile: 0.28},
                            variant="parenchyma_only", solver="adding-doubling")  # fmt: skip
    rng = np.random.default_rng(4)
    noisy = livlab.Spectrum(GRID, truth.value * (1 + 0.01 * rng.standard_normal(len(GRID))), 0.01 * truth.value)
    found = livlab.fit(noisy, {blood: (0.01, 0.35, 0.05), bile: (0.0, 0.38, 0.1)}, tissue="liver", changes=base,
                       variant="parenchyma_only", loss="chi2", scaling="none",
                       search={"standard_error": 3e-3, "most_recordings": 2})  # fmt: skip
    table = found.table
    assert table.loc["blood fraction", "lower"] < 0.11 < table.loc["blood fraction", "upper"]
    assert table.loc["bile fraction", "lower"] < 0.28 < table.loc["bile fraction", "upper"]
    told = found.notes[0]
    # Of the box 0.34 × 0.38 the triangle beyond blood + bile = 0.4 is cut off: (0.34 + 0.38 − 0.39)² / 2.
    share = 0.5 * (0.34 + 0.38 - 0.39) ** 2 / (0.34 * 0.38)
    assert float(told.split("%")[0].split()[-1]) / 100 == pytest.approx(share, abs=0.1)
    assert "cost infinity" in told
    assert not any("ConfigError" in str(x) for x in found.outcome.path["value"])
    assert np.isinf(found.outcome.path["value"]).any() or found.outcome.searches[0].failures == 0


def test_parameters_that_move_nothing_are_told_with_the_reason():
    """Fat only absorbs, and the reading does without the hepatocytes; blood moves the curve and is not told."""
    truth = livlab.spectrum("liver", "measured", GRID, variant="parenchyma_only", solver="adding-doubling")
    rng = np.random.default_rng(7)
    noisy = livlab.Spectrum(GRID, truth.value * (1 + 0.01 * rng.standard_normal(len(GRID))), 0.01 * truth.value)
    fat = LIVER + "lipid_and_water.parts.lipid.share"
    bounds = {LIVER + "blood.fraction": (0.01, 0.1), fat: (0.0, 0.4), LIVER + "hepatocyte.fraction": (0.3, 0.9)}
    found = livlab.fit(noisy, bounds, variant="parenchyma_only", loss="chi2", scaling="none",
                       search={"standard_error": 5e-3, "most_recordings": 2})  # fmt: skip
    told = [n for n in found.notes if "moves the curve by less than its error over its whole range" in n]
    assert [n.split(" moves")[0] for n in told] == ["lipid share", "hepatocyte fraction"]
    assert "adds no droplets" in told[0]
    assert "does without hepatocyte" in told[1]
