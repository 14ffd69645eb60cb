"""Inputs that both a case and its reference are made from."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from livlab.errors import InputError
from livlab.model.tissue.phase.base import Phase
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic, Rayleigh
from livlab.model.tissue.stack import OpticalStack, plain_stack
from livlab.units import FloatArray


def curve(level: float, variation: float, noise: float, points: int) -> tuple[FloatArray, FloatArray]:
    """Two curves around a level that vary by a share of it, the second with a ripple of its own."""
    t = np.linspace(0.0, 1.0, points)
    wave, ripple = np.sin(5.0 * t) + t, np.cos(37.0 * t)
    return level * (1.0 + variation * wave), level * (1.0 + variation * (wave + noise * ripple))


def phase(spec: list[Any]) -> Phase:
    """A phase function from ["henyey-greenstein", g], ["rayleigh"] or ["isotropic"]."""
    if spec[0] == "henyey-greenstein":
        return HenyeyGreenstein(float(spec[1]))
    if spec[0] in ("rayleigh", "isotropic"):
        return Rayleigh() if spec[0] == "rayleigh" else Isotropic()
    raise InputError.of("phase", spec[0], "must be henyey-greenstein, rayleigh or isotropic", "Name one of them.")


def stack(layers: list[list[Any]], n_above: float = 1.0, n_below: float = 1.0) -> OpticalStack:
    """A stack at one wavelength from [n, µ_a, µ_s, thickness, g or kind] a layer, in 1/mm and mm."""
    made = []
    for n, absorption, scattering, thickness, g in layers:
        scattered = phase([g]) if isinstance(g, str) else Isotropic() if g == 0 else HenyeyGreenstein(float(g))
        made.append((float(n), float(absorption), float(scattering), _length(thickness), scattered))
    return plain_stack(made, n_above=n_above, n_below=n_below)


def liver(reading: str, wavelength_nm: list[float], options: dict[str, Any] | None = None) -> OpticalStack:
    """The liver preset under a reading with some options changed."""
    from livlab.model.tissue.optics import optical_stack
    from livlab.model.tissue.presets import load_preset
    from livlab.model.tissue.readings import reading as named

    return optical_stack(load_preset("liver"), named(reading, **(options or {})), wavelength_nm)


def _length(thickness: float) -> float:
    return math.inf if math.isinf(thickness) else float(thickness)
