"""The measurement geometry, illumination and detection, in terms that every solver knows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from livlab.model.transport.source import Source
from livlab.model.transport.tally import Tally
from livlab.units import FloatArray

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class Readout:
    """An instrument in a solver's terms: value = Σ weights · binned flux + specular_weight · specular.

    Attributes
    ----------
    source, tally, half_width_mm
        Light, bins and sample of a walk.
    weights
        (θ, r) weight of each bin of the reflected flux.
    specular_weight
        Weight of the surface's mirror reflection.
    mirror_seen
        Whether the mirror direction lies within the cone, so that what inner interfaces return unscattered is read.
    notes
        What was simplified.
    """

    source: Source
    tally: Tally
    half_width_mm: float | None
    weights: FloatArray
    specular_weight: float
    mirror_seen: bool
    notes: tuple[str, ...] = ()

    @property
    def mu_min(self) -> float | None:
        """Least cosine of the cone that is read, None for the hemisphere."""
        return math.cos(self.tally.theta_edges[-1]) if self.tally.theta_edges else None

    def error_of_endless(self, solved: xr.Dataset) -> FloatArray:
        """(W,) stated error of `of_endless`: that of the cone, or of all that is reflected."""
        from livlab.model.transport.angular import cone_error

        mu_min = self.mu_min
        found = solved["reflectance_error"] if mu_min is None else cone_error(solved, mu_min)
        return np.asarray(float(np.abs(self.weights).max()) * found.to_numpy())

    def of_endless(self, solved: xr.Dataset) -> FloatArray:
        """(W,) the reading of an endless sample as adding–doubling solved it, through an endless port."""
        from livlab.model.transport.angular import cone_fraction

        if self.mu_min is not None:
            seen = cone_fraction(solved, self.mu_min).to_numpy()
            if self.mirror_seen:
                seen = seen + solved["unscattered_reflectance"].to_numpy()
        else:
            seen = solved["reflectance"].to_numpy()
        return np.asarray(float(self.weights[0, 0]) * seen + self.specular_weight * solved["specular"].to_numpy())


def total_reflectance(mu0: float = 1.0, *, specular: bool = False) -> Readout:
    """All light that leaves the lit side of an endless stack, for a collimated pencil.

    Parameters
    ----------
    mu0
        Cosine of incidence, in (0, 1].
    specular
        Whether the first surface's reflection counts.
    """
    return Readout(Source.collimated(math.acos(mu0)), Tally(), None, np.ones((1, 1)), float(specular), True)
