"""A ledger's answers: values with standard errors, effective sample sizes and gradients, at any coefficients."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.ledger.compress import SAYS, compress_ledger
from livlab.model.transport.ledger.data import Anchors, Coefficients, Compression, Detector, Entries
from livlab.model.transport.ledger.evaluate import Exponents, exponents, select, sums
from livlab.model.transport.ledger.plan import WORN, blend, levels, specular, wear_of
from livlab.model.transport.source import Source
from livlab.model.transport.tally import Tally
from livlab.units import FloatArray

if TYPE_CHECKING:
    import xarray as xr

Worn = Literal["mark", "raise", "walk"]
"""What happens to settings that a ledger cannot answer: marked invalid, an error, or (spectra) walked again."""

LEAST_SAMPLES = 100.0
"""Least effective sample size of a valid answer."""

_HAS_A_SAY = 0.1  # |c| from which an anchor's wear counts


@dataclass(frozen=True)
class Answer:
    """Values of a detector at S settings.

    Attributes
    ----------
    value, standard_error
        (S,) share of the incident light.
    effective_samples
        (S,) (Σ w)²/Σ w² of the photons seen.
    wear
        (S,) log of the variance that reweighting added, the worst of the anchors that matter.
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
    wear: FloatArray
    valid: np.ndarray[Any, np.dtype[np.bool_]]
    by_absorption: FloatArray
    by_scattering: FloatArray
    slope: FloatArray
    slope_error: FloatArray


@dataclass(frozen=True)
class Ledger:
    """Recorded photons, and what they were recorded with; make it by `record` or `load`.

    Attributes
    ----------
    entries, anchors
        The rows and the walks they come from.
    served
        Coefficients at the wavelengths served, sorted.
    degree, scaled, counted
        How the anchors' answers are put together (`ledger_plan`).
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
            wear = wear_of(sets, self.anchors, k, level[k], self.scaled, paths.T)
            worst = np.where(says, np.maximum(worst, wear), worst)
            if self.compression is not None:
                inside &= self.compression.holds(k, ex.theta) | (np.abs(c[:, k]) <= SAYS)
        ess = np.divide(counts**2, squares, out=np.zeros(size), where=squares > 0)
        valid = inside & (ess >= least_samples) & (worst <= WORN) & np.isfinite(value)
        return Answer(
            value,
            np.sqrt(variance),
            ess,
            worst,
            valid,
            by_a,
            by_s,
            slope,
            np.sqrt(slope_variance),
        )

    def evaluate(
        self,
        absorption: FloatArray,
        scattering: FloatArray,
        *,
        wavelength_nm: FloatArray | float | None = None,
        anisotropy: FloatArray | None = None,
        detector: Detector | None = None,
        gradient: bool = False,
        worn: Worn = "mark",
        least_samples: float = LEAST_SAMPLES,
    ) -> xr.Dataset:
        """Reflectance (or what a detector sees) for any number of parameter sets.

        Parameters
        ----------
        absorption, scattering
            (S, L) or (L,) 1/mm, as `PlaneLayer.absorption` and `.scattering`.
        wavelength_nm
            (S,) or one: whose phase functions and indices to use; default: the middle of the band.
        anisotropy
            (S, L) mean cosines if they differ from those served: scattering then acts by s (1 − g).
        detector
            Default: all that is reflected.
        gradient
            Whether to give the derivatives and their standard errors.
        worn
            "mark" or "raise" settings that are not valid.
        least_samples
            Effective sample size that a valid answer needs.

        Returns
        -------
        Dataset on `set` (and `layer`): value, value_se, ess, wear, valid; d_absorption, d_scattering in mm and
        their _se if asked: derivatives by a layer's coefficient, all else equal.

        Raises
        ------
        InputError
            Arrays that do not fit, are negative, or a wavelength beyond the band; with worn="raise" a setting that
            cannot be answered.
        """
        if worn not in ("mark", "raise"):
            raise InputError.of("worn", worn, "must be 'mark' or 'raise'", "Use spectrum to walk again.")
        from livlab.model.transport.ledger.tables import evaluation, refuse, settings_of, unit_tangents

        sets = settings_of(self, absorption, scattering, wavelength_nm, anisotropy)
        tangents = unit_tangents(len(sets), len(self.layers)) if gradient else ()
        found = self.answer(sets, detector or Detector.total(), tangents, least_samples, gradient=gradient)
        if worn == "raise":
            refuse(found, sets, least_samples)
        return evaluation(self, found, sets, gradient)

    def spectrum(
        self,
        stack: OpticalStack | None = None,
        *,
        worn: Worn = "raise",
        least_samples: float = LEAST_SAMPLES,
    ) -> xr.Dataset:
        """The spectrum of a stack, under the names that `walk` uses.

        Parameters
        ----------
        stack
            Layers as recorded, with other coefficients, wavelengths within the band, or (in endless layers) other
            thicknesses; default: the stack recorded.
        worn
            "raise", "mark", or "walk": record those wavelengths anew, to the same error (needs the stack).
        least_samples
            Effective sample size that a valid answer needs.

        Returns
        -------
        Dataset on `wavelength`: reflectance, transmittance, lost, residual, each with its `_se`; specular; taken:
        absorbed in all layers together or removed by a factor of Algorithm 2 (the rest); ess, wear, valid;
        reflectance_binned and transmittance_binned (_se) if there are bins. Attribute interpolation_bias: the
        largest error of the interpolation between anchors found half-way between them.

        Raises
        ------
        InputError
            A stack that differs in layers or indices, or wavelengths that cannot be answered.
        """
        if worn not in get_args(Worn):
            raise InputError.of("worn", worn, "must be 'raise', 'mark' or 'walk'", "Name one.")
        if worn == "walk" and stack is None:
            raise InputError.of("stack", None, "is needed to walk again", "Give the stack.")
        from livlab.model.transport.ledger.tables import fitted, spectrum

        sets = self.served if stack is None else fitted(self, stack)
        return spectrum(self, sets, stack, worn, least_samples)

    def gradient(
        self,
        make: Callable[[Mapping[str, float]], OpticalStack],
        parameters: Mapping[str, float],
        *,
        step: float = 1e-3,
        detector: Detector | None = None,
    ) -> xr.Dataset:
        """Derivatives by tissue parameters: exact in the coefficients, by the chain rule.

        The coefficients are smooth functions of the parameters, computed without chance, so that their central
        differences are accurate; the ledger's derivatives by them are exact, and the standard error is that of the
        photons' own derivatives.

        Parameters
        ----------
        make
            From parameters to a stack that `spectrum` accepts.
        parameters
            Values by name.
        step
            Relative step of the differences (absolute for a value of 0).
        detector
            Default: all that is reflected.

        Returns
        -------
        Dataset on (`parameter`, `wavelength`): gradient, gradient_se; value, value_se, valid on `wavelength`.
        """
        from livlab.model.transport.ledger.tables import parameter_gradient

        return parameter_gradient(self, make, parameters, step, detector or Detector.total())

    def compressed(
        self,
        tolerance: float | None = None,
        *,
        absorption_spread: float = 0.2,
        scattering_spread: float = 0.0,
        also: Sequence[OpticalStack] = (),
    ) -> Ledger:
        """A small ledger with nearly the same answers.

        Parameters
        ----------
        tolerance
            Largest change of reflectance and transmittance over the domain, as a share of the incident light;
            default: a tenth of the standard error.
        absorption_spread, scattering_spread
            The domain is what is served, and that with each layer's coefficient changed by ± this share; answers
            beyond it are marked as not valid. A spread of scattering in layers with many scatterings costs rows.
        also
            Further stacks that belong to the domain, such as the corners of a fit's bounds.

        Returns
        -------
        Ledger whose `compression` tells the error measured over the domain.

        Raises
        ------
        InputError
            An argument out of bounds, or a ledger that is compressed already.
        """
        from livlab.model.transport.ledger.tables import fitted

        sets = [fitted(self, stack) for stack in also]
        return compress_ledger(self, tolerance, absorption_spread, scattering_spread, sets)

    def save(self, path: Path | str) -> None:
        """Write a NetCDF file that `load` reads.

        Raises
        ------
        EnvironmentProblem
            The file cannot be written.
        """
        from livlab.model.transport.ledger.file import save

        save(self, Path(path))


def _spread(square: FloatArray, total: FloatArray, n: float) -> FloatArray:
    """n² times the variance of the mean of n photons."""
    return np.maximum(square - total**2 / n, 0.0) * n / (n - 1.0)
