"""What a walk recorded, and the answers that follow from it: all that compression, files and tables need to know."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from livlab.model.transport.ledger.data import Anchors, Coefficients, Compression, Detector, Entries
from livlab.model.transport.ledger.evaluate import Exponents, exponents, select, sums
from livlab.model.transport.ledger.plan import LARGEST_DEGENERACY, blend, degeneracy_of, levels, specular
from livlab.model.transport.source import Source
from livlab.model.transport.tally import Tally
from livlab.units import FloatArray

WhenDegenerate = Literal["mark", "raise", "walk"]
"""What happens to settings that cannot be answered: marked invalid, an error, or (spectra) walked again."""

LEAST_SAMPLES = 100.0
"""Least effective sample size of a valid answer."""

SAYS = 1e-3
"""Least |c| of an anchor that has a say in an answer."""

_HAS_A_SAY = 0.1  # |c| from which an anchor's weight degeneracy counts


@dataclass(frozen=True)
class Answer:
    """Values of a detector at S settings.

    Attributes
    ----------
    value, standard_error
        (S,) share of the incident light.
    effective_samples
        (S,) (Σ w)²/Σ w² of the photons seen.
    degeneracy
        (S,) weight degeneracy: log of the variance that reweighting added, the worst of the anchors that matter.
    valid
        (S,) whether the ledger can answer.
    by_absorption, by_scattering
        (S, L) derivatives by the layers' coefficients, mm; rough unless asked for.
    slope, slope_error
        (D, S) derivatives along the tangents asked for.
    """

    value: FloatArray
    standard_error: FloatArray
    effective_samples: FloatArray
    degeneracy: FloatArray
    valid: np.ndarray[Any, np.dtype[np.bool_]]
    by_absorption: FloatArray
    by_scattering: FloatArray
    slope: FloatArray
    slope_error: FloatArray


@dataclass(frozen=True)
class Recording:
    """Recorded photons, and what they were recorded with.

    Attributes
    ----------
    entries, anchors
        The rows and the walks they come from.
    served
        Coefficients at the wavelengths served, sorted.
    degree, scaled, counted
        How the anchors' answers are put together (`plan`).
    tally, source, positions
        Bins, light, and whether places of exit are known.
    paths
        (L,) mean path of the photons that left, mm.
    bear
        (L,) share of the smooth change of scattering that reweighting bears.
    depth_bias
        Bound of what taking the last layer as endless may change.
    about
        Seed, variant, names, digest of the stack, seconds.
    compression
        How it was binned, None as recorded.
    """

    entries: Entries
    anchors: Anchors
    served: Coefficients
    degree: int
    scaled: bool
    counted: tuple[int, ...]
    tally: Tally
    source: Source
    positions: bool
    paths: FloatArray
    bear: FloatArray
    depth_bias: float
    about: Mapping[str, Any]
    compression: Compression | None = None
    _rows: dict[Detector, Any] = field(default_factory=dict, compare=False, repr=False)

    def __len__(self) -> int:
        return len(self.entries)

    @property
    def photons(self) -> int:
        """Photons walked, all anchors together."""
        return int(self.anchors.photons.sum())

    @property
    def layers(self) -> tuple[str, ...]:
        """Names."""
        return tuple(self.about["layers"])

    def blend(self, wavelength_nm: FloatArray) -> FloatArray:
        """(S, K) weights of the anchors: a function of the wavelength alone, so that answers have exact gradients."""
        return blend(np.asarray(wavelength_nm), self.anchors.wavelength_nm, self.degree)

    def theta(self, sets: Coefficients) -> tuple[FloatArray, list[Exponents]]:
        """The weights of the anchors, and for each the exponents of its rows."""
        c = self.blend(sets.wavelength_nm)
        level = levels(self.anchors, c, self.bear)
        rest = (self.scaled, self.counted)
        return c, [exponents(sets, self.anchors, k, level[k], *rest) for k in range(len(self.anchors))]

    def answer(
        self,
        sets: Coefficients,
        detector: Detector,
        tangents: Sequence[tuple[FloatArray, FloatArray]] = (),
        least_samples: float = LEAST_SAMPLES,
        *,
        gradient: bool = False,
    ) -> Answer:
        """Values at settings, on bare arrays.

        Parameters
        ----------
        sets
            Coefficients in layers of the recorded thickness.
        detector
            What counts.
        tangents
            Pairs of (S, L) changes of absorption and scattering along which slopes are wanted.
        least_samples
            Below this effective sample size an answer is not valid.
        gradient
            Whether the derivatives by the coefficients are wanted exactly; else they are estimates.
        """
        if detector not in self._rows:
            if len(self._rows) > 8:
                self._rows.clear()
            self._rows[detector] = select(self.entries, len(self.anchors), detector, self.tally, self.positions)
        size, layers = sets.absorption.shape
        c, theta = self.theta(sets)
        value, variance, counts, squares, worst = (np.zeros(size) for _ in range(5))
        by_a, by_s = np.zeros((size, layers)), np.zeros((size, layers))
        slope, slope_variance = (np.zeros((len(tangents), size)) for _ in range(2))
        inside = np.ones(size, dtype=bool)
        layer_of = [*range(layers), *self.counted]
        level = levels(self.anchors, c, self.bear)
        enters = 1.0 - specular(sets.index, self.source)
        for k, rows in enumerate(self._rows[detector]):
            if not np.abs(c[:, k]).max() > 0:
                continue
            ex = theta[k]
            along = [ex.by_absorption * a.T[layer_of] + ex.by_scattering * s.T[layer_of] for a, s in tangents]
            found = sums(rows, ex.theta, along, gradient)
            n = float(self.anchors.photons[k])
            entry = enters / (1.0 - specular(self.anchors.index[k : k + 1], self.source)[0])
            share = c[:, k] * entry / n
            value += share * found.count
            variance += share**2 * _spread(found.square, found.count, n)
            counts += np.abs(share) * found.count
            squares += share**2 * found.square
            for f, layer in enumerate(layer_of):
                by_a[:, layer] += share * found.features[f] * ex.by_absorption[f]
                by_s[:, layer] += share * found.features[f] * ex.by_scattering[f]
            slope += share * found.slope
            slope_variance += share**2 * _spread(found.slope_square, found.slope, n)
            seen = found.count > 0
            paths = np.divide(found.features[:layers], found.count, out=np.zeros((layers, size)), where=seen)
            says = np.abs(c[:, k]) >= _HAS_A_SAY
            degeneracy = degeneracy_of(sets, self.anchors, k, level[k], self.scaled, paths.T)
            worst = np.where(says, np.maximum(worst, degeneracy), worst)
            if self.compression is not None:
                inside &= self.compression.holds(k, ex.theta) | (np.abs(c[:, k]) <= SAYS)
        ess = np.divide(counts**2, squares, out=np.zeros(size), where=squares > 0)
        valid = inside & (ess >= least_samples) & (worst <= LARGEST_DEGENERACY) & np.isfinite(value)
        return Answer(
            value=value,
            standard_error=np.sqrt(variance),
            effective_samples=ess,
            degeneracy=worst,
            valid=valid,
            by_absorption=by_a,
            by_scattering=by_s,
            slope=slope,
            slope_error=np.sqrt(slope_variance),
        )


def _spread(square: FloatArray, total: FloatArray, n: float) -> FloatArray:
    """n² times the variance of the mean of n photons."""
    return np.maximum(square - total**2 / n, 0.0) * n / (n - 1.0)
