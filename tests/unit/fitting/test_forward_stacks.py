"""What makes a fit fast must not change it: stacks by layers, answers in a band, slopes, how errors hang together."""

from __future__ import annotations

import numpy as np
import pytest

from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
from livlab.errors import ConfigError, LivlabError
from livlab.fitting.forward import LedgerForward
from livlab.fitting.stacks import StackMaker
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import READINGS
from livlab.model.tissue.tissue import override
from livlab.model.transport.ledger.data import Coefficients

GRID = np.arange(500.0, 700.0, 20.0)
AT = "layers.parenchyma.elements.blood"
NAMES = (
    f"{AT}.fraction",
    f"{AT}.oxygenation",
    "layers.capsule.thickness_mm",
    "layers.parenchyma.elements.bile.fraction",
)


@pytest.mark.parametrize("reading", ["thesis", "consistent", "measured"])
def test_stacks_by_layers_are_the_stacks_of_the_tissue(reading: str) -> None:
    make = StackMaker(load_preset("liver"), READINGS[reading], GRID, NAMES)
    rng = np.random.default_rng(3)
    for _ in range(6):
        drawn = rng.uniform([0.01, 0.0, 0.03, 0.0], [0.1, 1.0, 0.1, 0.05])
        values = dict(zip(NAMES, drawn, strict=True))
        quick, slow = make(values), make.slow(values)
        a, b = Coefficients.of(quick), Coefficients.of(slow)
        for name in ("absorption", "scattering", "anisotropy", "index", "thickness_mm"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        assert quick.name == slow.name
        assert set(quick.notes) == set(slow.notes)


def test_values_that_make_no_tissue_are_told_as_ever() -> None:
    make = StackMaker(load_preset("liver"), READINGS["measured"], GRID, NAMES[:1])
    make({NAMES[0]: 0.05})
    with pytest.raises(ConfigError) as slow:
        make.slow({NAMES[0]: 1.5})
    with pytest.raises(ConfigError) as quick:
        make({NAMES[0]: 1.5})
    assert quick.value.message == slow.value.message
    path = "layers.parenchyma.elements.blod.fraction"
    with pytest.raises(LivlabError, match="no 'blod'"):
        StackMaker(load_preset("liver"), READINGS["measured"], GRID, [path])({path: 0.1})


@pytest.fixture(scope="module")
def forward() -> LedgerForward:
    tissue = override(load_preset("liver"), {"layers.parenchyma.thickness_mm": float("inf")})
    camera = HyperspectralCamera(illumination_deg=45.0, polarisation="crossed", acceptance_deg=60.0)
    return LedgerForward(tissue, READINGS["measured"], GRID, camera, NAMES[:2], standard_error=8e-3)


VALUES = {NAMES[0]: 0.04, NAMES[1]: 0.4}


def test_answers_in_a_band_are_those_of_the_whole(forward: LedgerForward) -> None:
    forward.record(VALUES, seed=4)
    whole = forward.answer(VALUES, gradient=True)
    use = GRID >= 580.0
    forward.focus(use)
    part = forward.answer(VALUES, gradient=True)
    forward.focus(None)
    np.testing.assert_allclose(part.value[use], whole.value[use], rtol=1e-12)
    assert np.isnan(part.value[~use]).all()
    assert not part.valid[~use].any()
    for name in NAMES[:2]:
        np.testing.assert_allclose(part.slopes[name][use], whole.slopes[name][use], rtol=1e-6)


def test_slopes_are_differences_of_answers(forward: LedgerForward) -> None:
    forward.record(VALUES, seed=4)
    found = forward.answer(VALUES, gradient=True)
    for name, value in VALUES.items():
        ends = [forward.answer({**VALUES, name: value * f}).value for f in (1.001, 0.999)]
        wanted = (ends[0] - ends[1]) / (0.002 * value)
        np.testing.assert_allclose(found.slopes[name], wanted, rtol=1e-4, atol=1e-5 * np.abs(wanted).max())


def test_errors_hang_together_as_fresh_walks_show(forward: LedgerForward) -> None:
    # 40 walks: a correlation is known to 0.16 at most, a variance to 23 %; independent errors would be off by 0.9.
    drawn, told = [], []
    for seed in range(40):
        forward.record(VALUES, seed=100 + seed)
        drawn.append(forward.answer(VALUES).value)
        told.append(forward.noise_covariance(VALUES))
    found, wanted = np.cov(np.array(drawn).T), np.mean(told, axis=0)
    np.testing.assert_allclose(np.diag(found) / np.diag(wanted), 1.0, atol=4 * np.sqrt(2 / 39))
    scale = np.sqrt(np.diag(wanted))
    strong = wanted / np.outer(scale, scale)
    assert strong[0, 1] > 0.5
    assert np.abs(found / np.outer(scale, scale) - strong).max() < 4 * np.sqrt(2 / 39)
