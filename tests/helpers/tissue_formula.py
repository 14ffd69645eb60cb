"""An endless tissue in closed form, for tests that need thousands of fits: blood in vessels, bile, a power law.

Absorption: f c(r) µ_blood(S) + bile µ_bile, c of vessels of radius r (van Veen et al. 2002, eq. 4); reflectance of a
half space by diffusion (Farrell et al. 1992, eq. 15, internal reflection of n = 1.4). The bands of haemoglobin and bile
are Gaussians of about their heights and widths: what is tested is statistics, which wants bands and not these bands.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from fit_forwards import StandIn

GRID = np.arange(500.0, 721.0, 10.0)
"""23 wavelengths in nm."""

NAMES = ("blood", "oxygenation", "bile", "radius")
TRUTH = {"blood": 0.05, "oxygenation": 0.6, "bile": 0.5, "radius": 20.0}


def bands(x: Any, *each: tuple[float, float, float]) -> Any:
    """Sum of Gaussians: height, centre, width."""
    return sum(h * np.exp(-0.5 * ((x - c) / w) ** 2) for h, c, w in each)


def oxygenated(x: Any) -> Any:
    """Absorption of oxygenated blood in 1/mm, roughly."""
    return bands(x, (28.0, 542.0, 13.0), (29.0, 577.0, 9.0), (30.0, 480.0, 30.0)) + 0.15


def reduced(x: Any) -> Any:
    """Absorption of reduced blood in 1/mm, roughly."""
    return bands(x, (28.0, 556.0, 22.0), (12.0, 480.0, 30.0), (1.6, 640.0, 45.0)) + 0.6


def bile(x: Any) -> Any:
    """Absorption of bile in 1/mm, roughly."""
    return bands(x, (1.5, 440.0, 45.0), (0.05, 650.0, 30.0))


def reflectance(absorption: Any, scattering: Any) -> Any:
    """Of an endless tissue (Farrell 1992)."""
    albedo = scattering / (absorption + scattering)
    root = np.sqrt(3.0 * (1.0 - albedo))
    return 0.5 * albedo * (1.0 + np.exp(-4.0 / 3.0 * 2.95 * root)) * np.exp(-root)


def coefficients(values: Mapping[str, Any], x: Any = GRID) -> tuple[Any, Any]:
    """Absorption and reduced scattering in 1/mm."""
    inside = values["oxygenation"] * oxygenated(x) + (1.0 - values["oxygenation"]) * reduced(x)
    thick = 2e-3 * values["radius"] * inside
    absorption = values["blood"] * inside * (1.0 - np.exp(-thick)) / thick + values["bile"] * bile(x) + 0.01
    return absorption, 1.1 * (x / 500.0) ** -values.get("power", 1.0)


def curve(values: Mapping[str, Any], x: Any = GRID) -> Any:
    """The reflectance at given values."""
    return reflectance(*coefficients(values, x))


@dataclass
class Formula(StandIn):
    """The forward model; its slopes by the complex step, which is exact. `names` are what may vary."""

    names: tuple[str, ...] = NAMES
    fixed: dict[str, float] = field(default_factory=lambda: dict(TRUTH))
    x: Any = field(default_factory=lambda: GRID)

    def curve(self, values: Mapping[str, float]) -> tuple[Any, Any, dict[str, Any]]:
        at = {**self.fixed, **values}
        slopes = {n: np.imag(curve({**at, n: at[n] + 1e-20j}, self.x)) / 1e-20 for n in self.names}
        return curve(at, self.x), np.zeros(len(self.x)), slopes


def _scattered(values: Mapping[str, Any], how: Callable[[Any, Any], tuple[Any, Any]]) -> Any:
    return reflectance(*how(*coefficients(values)))


WRONG: dict[str, Callable[[float], Any]] = {
    "a narrow band at 530 nm": lambda a: curve(TRUTH) * (1 - bands(GRID, (a, 530.0, 8.0))),
    "a band at 630 nm": lambda a: curve(TRUTH) * (1 - bands(GRID, (a, 630.0, 12.0))),
    "a broad band at 680 nm": lambda a: curve(TRUTH) * (1 - bands(GRID, (a, 680.0, 35.0))),
    "two bands of a dye": lambda a: curve(TRUTH) * (1 - bands(GRID, (a, 600.0, 12.0), (0.6 * a, 660.0, 15.0))),
    "melanin": lambda a: _scattered(TRUTH, lambda m, s: (m + a * (GRID / 500.0) ** -3.5, s)),
    "steeper scattering": lambda a: curve({**TRUTH, "power": 1.0 + a}),
    "a second power law": lambda a: _scattered(TRUTH, lambda m, s: (m, s + a * (GRID / 500.0) ** -4.0)),
    "stray light": lambda a: (1 - a) * curve(TRUTH) + a * 0.3,
    "wavelengths off by a shift": lambda a: curve(TRUTH, GRID + 10.0 * a),
    "a stretched wavelength scale": lambda a: curve(TRUTH, 600.0 + (1.0 + 0.1 * a) * (GRID - 600.0)),
    "a blurred monochromator": lambda a: sum(curve(TRUTH, GRID + 20.0 * abs(a) * s) for s in (-1, 0, 1)) / 3.0,
    "a white layer on top": lambda a: curve(TRUTH) + a * (1.0 - curve(TRUTH)) ** 2 * (GRID / 500.0) ** -2.0,
}
"""Twelve ways in which data are another tissue's, or another instrument's, by a size."""
