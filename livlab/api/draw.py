"""Axes for the plots of a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def axes(ax: Axes | None) -> Axes:
    """The axes given, or new ones that a notebook shows."""
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    from livlab.reports.figures import style

    with style():
        _, made = plt.subplots(figsize=(6.4, 3.8))
    return made
