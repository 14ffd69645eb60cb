"""Units, converted once, at the boundary.

Inside the code lengths are in mm, coefficients in 1/mm, wavelengths in nm, angles in radians.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
_T = TypeVar("_T", float, FloatArray)

MM_PER_UM = 1e-3
MM_PER_CM = 10.0


def um_to_mm(value: _T) -> _T:
    """Micrometres to millimetres."""
    return value * MM_PER_UM


def nm_to_mm(value: _T) -> _T:
    """Nanometres to millimetres."""
    return value * 1e-6


def cm_to_mm(value: _T) -> _T:
    """Centimetres to millimetres."""
    return value * MM_PER_CM


def per_cm_to_per_mm(value: _T) -> _T:
    """Coefficient in 1/cm to 1/mm."""
    return value / MM_PER_CM


def per_mm_to_per_cm(value: _T) -> _T:
    """Coefficient in 1/mm to 1/cm."""
    return value * MM_PER_CM
