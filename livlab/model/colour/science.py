"""The door to colour-science."""

from __future__ import annotations

from typing import Any

import numpy as np


def colour_science() -> Any:
    """The module `colour`, imported on first use; unlike a plain import it leaves NumPy's way of printing alone."""
    with np.printoptions():
        import colour

    return colour
