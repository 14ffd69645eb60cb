"""Cells in Rusinkiewicz's half-angle coordinates: their edges, and which cell a pair of directions belongs to.

Reciprocity, f(wi, wo) = f(wo, wi), makes f periodic in φ_d with π, so cells reach over [0, π). An isotropic material
that is its own mirror image has f(φ_d) = f(−φ_d) too; a grid that ends at π/2 uses that as well.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import xarray as xr

from livlab.brdf.angles import from_half_angles
from livlab.errors import InputError

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
DIMS = ("theta_h", "theta_d", "phi_d")


class Placed(NamedTuple):
    """Cells of samples: flat index (n,), folded azimuth (n,), and whether light and eye change places by folding."""

    cell: npt.NDArray[np.intp]
    phi_d: FloatArray
    swapped: BoolArray


@dataclass(frozen=True, eq=False)
class Grid:
    """Edges of cells in θ_h, θ_d and φ_d, radians, each rising from 0: to π/2, π/2, and π or π/2.

    Raises
    ------
    InputError
        Edges that do not rise or do not reach over the whole range.
    """

    theta_h: FloatArray
    theta_d: FloatArray
    phi_d: FloatArray

    def __post_init__(self) -> None:
        for name in DIMS:
            edges = np.asarray(getattr(self, name), dtype=np.float64)
            ends = (np.pi, np.pi / 2) if name == "phi_d" else (np.pi / 2,)
            rising = edges.ndim == 1 and len(edges) > 1 and bool(np.all(np.diff(edges) > 0)) and edges[0] == 0
            if not rising or not any(abs(edges[-1] - end) < 1e-9 for end in ends):
                raise InputError.of(
                    f"grid.{name}",
                    edges.tolist(),
                    f"edges must rise from 0 to {' or '.join(f'{end:.6g}' for end in ends)}",
                    "Give them in radians; Grid.uniform and Grid.merl make usual ones.",
                )
            object.__setattr__(self, name, edges)

    @classmethod
    def uniform(
        cls, theta_h_deg: float = 2.0, theta_d_deg: float = 2.0, phi_d_deg: float = 4.0, *, mirror: bool = False
    ) -> "Grid":
        """Cells of equal size in degrees, rounded so that they fill the range.

        >>> Grid.uniform().shape
        (45, 45, 45)
        """
        for name, size in zip(DIMS, (theta_h_deg, theta_d_deg, phi_d_deg), strict=True):
            if not 0.1 <= size <= 90:
                raise InputError.of(f"{name}_deg", size, "must lie between 0.1 and 90 degrees", "Give 2, 2 and 4.")
        across = np.pi / 2 if mirror else np.pi
        counts = (round(90 / theta_h_deg), round(90 / theta_d_deg), round(np.rad2deg(across) / phi_d_deg))
        ends = (np.pi / 2, np.pi / 2, across)
        return cls(*(np.linspace(0, end, max(count, 1) + 1) for end, count in zip(ends, counts, strict=True)))

    @classmethod
    def merl(cls) -> "Grid":
        """Cells of the MERL data base (Matusik et al. 2003): 90 whose size grows with √θ_h, 90 of 1°, 180 of 1°."""
        return cls((np.arange(91) / 90) ** 2 * (np.pi / 2), np.linspace(0, np.pi / 2, 91), np.linspace(0, np.pi, 181))

    @property
    def mirror(self) -> bool:
        """Whether φ_d and −φ_d share a cell."""
        return bool(self.phi_d[-1] < 3)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Cells along θ_h, θ_d, φ_d."""
        return len(self.theta_h) - 1, len(self.theta_d) - 1, len(self.phi_d) - 1

    @property
    def size(self) -> int:
        """Number of cells."""
        return int(np.prod(self.shape))

    def centres(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Middles of the cells along each coordinate; MERL's θ_h in the middle of √θ_h, as its readers have it."""
        theta_h, theta_d, phi_d = ((edges[1:] + edges[:-1]) / 2 for edges in (self.theta_h, self.theta_d, self.phi_d))
        if self.shape[0] == 90 and np.allclose(self.theta_h, Grid.merl().theta_h, atol=1e-12):
            theta_h = ((np.arange(90) + 0.5) / 90) ** 2 * (np.pi / 2)
        return theta_h, theta_d, phi_d

    def directions(self) -> tuple[FloatArray, FloatArray]:
        """Directions wi, wo (θ_h, θ_d, φ_d, 3) at the cells' middles."""
        return from_half_angles(*np.meshgrid(*self.centres(), indexing="ij"))

    def reachable(self, max_angle: float = np.pi / 2) -> BoolArray:
        """Cells (θ_h, θ_d, φ_d) whose middle has both directions above the surface, within an angle of its normal."""
        wi, wo = self.directions()
        least = max(np.cos(max_angle), 1e-12)
        return np.asarray((wi[..., 2] >= least) & (wo[..., 2] >= least))

    def fold(self, phi_d: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Azimuths (n,) in the grid's range, and whether light and eye changed places on the way."""
        turned = np.mod(phi_d, 2 * np.pi)
        folded = np.mod(turned, np.pi)
        if self.mirror:
            return np.minimum(folded, np.pi - folded), np.cos(turned) < 0
        return folded, (turned >= np.pi) & (turned < 2 * np.pi)

    def place(self, theta_h: FloatArray, theta_d: FloatArray, phi_d: FloatArray) -> Placed:
        """Cells of half-angle coordinates (n,)."""
        folded, swapped = self.fold(phi_d)
        index = [
            np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
            for edges, values in zip((self.theta_h, self.theta_d, self.phi_d), (theta_h, theta_d, folded), strict=True)
        ]
        return Placed(np.ravel_multi_index(index, self.shape), folded, swapped)

    def coordinates(self) -> dict[str, tuple[str, FloatArray, dict[str, str]]]:
        """Middles and edges as coordinates of a data set."""
        middle = {
            name: (name, values, {"units": "rad", "long_name": f"middle of the cell in {name}"})
            for name, values in zip(DIMS, self.centres(), strict=True)
        }
        edge = {
            f"{name}_edge": (f"{name}_edge", getattr(self, name), {"units": "rad", "long_name": f"edges in {name}"})
            for name in DIMS
        }
        return middle | edge


def grid_of(table: xr.Dataset) -> Grid:
    """The grid of a table.

    Raises
    ------
    InputError
        The data set is no table in half-angle cells.
    """
    if any(f"{name}_edge" not in table.coords for name in DIMS) or "value" not in table:
        raise InputError.of(
            "table",
            sorted(map(str, table.variables)),
            "must be a table in half-angle cells, with value and the edges of theta_h, theta_d and phi_d",
            "Merge samples with livlab.brdf.table.merge first.",
        )
    return Grid(*(table[f"{name}_edge"].values for name in DIMS))
