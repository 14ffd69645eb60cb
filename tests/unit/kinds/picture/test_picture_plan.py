"""Which wavelengths a picture's plan is made at, what light above colours, and the speed claim."""

from __future__ import annotations

import numpy as np
from picture_fakes import small

from livlab.effects.plane import ANGLES_DEG, widest_change
from livlab.kinds.picture.claims import PictureSummary, judge
from livlab.kinds.picture.colour import colour_routes
from livlab.kinds.picture.config import Colour
from livlab.kinds.picture.plan import LOOKED_AT, looked_at_of
from livlab.kinds.picture.tables import optics
from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.phase.functions import Isotropic
from livlab.model.tissue.readings import READINGS
from livlab.model.tissue.stack import plain_stack

GRID, _ = colour_routes(Colour(kappa_nm=20.0, count=5), seed=1)
STACKS = {("", name): optical_stack(small().tissue.build(), READINGS[name], GRID) for name in ("thesis", "measured")}


def test_a_plan_looks_where_the_tissue_absorbs_least_and_most() -> None:
    stack = STACKS["", "measured"]
    absorbed = np.stack([i.rate * (1 - i.albedo) for i in stack.layers[-1].interactions]).sum(axis=0)
    found = looked_at_of(stack)
    assert len(found) == LOOKED_AT
    assert found == sorted(found)
    assert {int(absorbed.argmin()), int(absorbed.argmax())} <= set(found)
    assert looked_at_of(stack.at([2])) == [0]


def test_the_capsules_haze_is_bluer_under_the_thesis_reading_than_the_parenchyma_is_bright() -> None:
    """Rayleigh's law for elastin makes the capsule scatter blue; the table says by how much."""
    _, rows = optics(STACKS, (700.0, 435.8))
    red, blue = (r for r in rows if r["reading"] == "thesis")
    above = [float(str(r["depth_above"])) for r in (red, blue)]
    stack = STACKS["", "thesis"]
    k = int(np.abs(GRID - 700.0).argmin())
    own = sum(
        layer.thickness_mm
        * sum(float(i.rate[k] * i.albedo[k]) * (1 - i.phases[k].anisotropy) for i in layer.interactions)
        for layer in stack.layers[:-1]
    )
    assert np.isclose(above[0], own, rtol=1e-9)
    assert above[1] > 2 * above[0] > 0


def test_speed_is_a_claim_of_samples_a_second() -> None:
    text = '\n[[criterion]]\nmetric = "speed"\nreading = "thesis"\nwithin = [1e6, 1e9]\n'
    config = small(text)
    slow, fast = (PictureSummary({}, 0.1, 2.0, 1.0, v) for v in (9e5, 2e6))
    assert [judge(config, {("", "thesis"): s})[0].verdict for s in (slow, fast)] == ["FAIL", "PASS"]


def test_what_a_plan_moves_is_the_largest_change_at_any_angles() -> None:
    """Half-spaces that scatter alike in all directions, in closed form: πL/E = a H(µ) H(µ0) / 4 (µ + µ0)."""
    cosine = np.cos(np.radians(ANGLES_DEG))
    node, weight = np.polynomial.legendre.leggauss(64)
    node, weight = 0.5 * (node + 1.0), 0.5 * weight

    def factor(albedo: float) -> np.ndarray:
        at = np.concatenate([node, cosine])
        h = np.ones_like(at)
        for _ in range(200):  # 1/H = sqrt(1 - a) + a/2 times the integral: Chandrasekhar 1950, ch. V
            inner = (node * h[: len(node)] * weight / (at[:, None] + node)).sum(axis=1)
            h = 1.0 / (np.sqrt(1.0 - albedo) + 0.5 * albedo * inner)
        h = h[len(node) :]
        return np.asarray(albedo / 4.0 * h[:, None] * h / (cosine[:, None] + cosine))

    some, more = (plain_stack([(1.0, 1.0 - a, a, np.inf, Isotropic())]) for a in (0.8, 0.9))
    wanted = np.abs(factor(0.9) - factor(0.8)).max()
    assert np.isclose(widest_change(some, more), wanted, rtol=1e-4)
    assert widest_change(some, some) == 0.0
