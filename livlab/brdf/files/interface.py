"""What a file format of BRDFs consists of: how it is read, and, where it is written, how from values or a function."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol, get_args

if TYPE_CHECKING:
    import xarray as xr

    from livlab.brdf.grid import Grid
    from livlab.units import FloatArray

Holes = Literal["refuse", "fill", "zero"]
"""What becomes of a table's holes in a format that cannot say that nothing was measured."""

HOLES: tuple[str, ...] = get_args(Holes)


class Function(Protocol):
    """A BRDF that a file holds as a function of directions, not as values."""

    @property
    def name(self) -> str:
        """What it is called."""

    @property
    def source(self) -> str:
        """Where it comes from, for the attributes of a table made of it."""

    @property
    def channels(self) -> Sequence[object]:
        """Labels of its channels."""

    @property
    def exact(self) -> bool:
        """Whether `convert` evaluates it at the other format's own points; if not, it is tabulated first."""

    def evaluate(self, wi: FloatArray, wo: FloatArray) -> FloatArray:
        """BRDF (n, channel) in 1/sr without cosine at directions (n, 3)."""

    def known(self, wi: FloatArray, wo: FloatArray) -> FloatArray:
        """The same, NaN where the file cannot tell it."""


@dataclass(frozen=True)
class FileFunctions:
    """A format: the object `FILE` of its module.

    Parameters
    ----------
    read
        Samples, a table, or a function, of a file.
    write
        Writes samples or a table (`livlab.brdf.table.check_brdf` has seen them), holes as said; None: not written.
    write_function
        Writes a function, evaluated where the format has its values, so that there are no holes.

    Raises
    ------
    TypeError
        Only one of the two that write.
    """

    read: Callable[[Path], xr.Dataset | Function]
    write: Callable[[Path, xr.Dataset, Holes], None] | None = None
    write_function: Callable[[Path, Function], None] | None = None

    def __post_init__(self) -> None:
        if (self.write is None) != (self.write_function is None):
            raise TypeError("a format that is written has both write and write_function")


def tabulated(function: Function, grid: Grid | None = None) -> xr.Dataset:
    """A table of a function's values at the middles of cells, `Grid.uniform`'s if none are given."""
    from livlab.brdf import grid as grids
    from livlab.brdf.lookup import tabulate

    table = tabulate(function.known, grid or grids.Grid.uniform(), function.channels)
    return table.assign_attrs(source=function.source)
