"""A ledger's answers: values with standard errors, effective sample sizes and gradients, at any coefficients."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.ledger import file, tables
from livlab.model.transport.ledger.compress import compress_ledger
from livlab.model.transport.ledger.data import Detector
from livlab.model.transport.ledger.recording import LEAST_SAMPLES, Recording, WhenDegenerate
from livlab.units import FloatArray

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Ledger", "load"]


@dataclass(frozen=True)
class Ledger(Recording):
    """A recording that answers in tables, is made small and saved; make it by `record` or `load`."""

    def evaluate(
        self,
        absorption: FloatArray,
        scattering: FloatArray,
        *,
        wavelength_nm: FloatArray | float | None = None,
        anisotropy: FloatArray | None = None,
        detector: Detector | None = None,
        gradient: bool = False,
        degenerate: WhenDegenerate = "mark",
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
        degenerate
            "mark" or "raise" settings at which the weights degenerate, or that are not valid for another reason.
        least_samples
            Effective sample size that a valid answer needs.

        Returns
        -------
        Dataset on `set` (and `layer`): value, value_se, ess, degeneracy, valid; d_absorption, d_scattering in mm and
        their _se if asked: derivatives by a layer's coefficient, all else equal.

        Raises
        ------
        InputError
            Arrays that do not fit, are negative, or a wavelength beyond the band; with degenerate="raise" a setting
            that cannot be answered.
        """
        if degenerate not in ("mark", "raise"):
            raise InputError.of("degenerate", degenerate, "must be 'mark' or 'raise'", "Use spectrum to walk again.")
        sets = tables.settings_of(self, absorption, scattering, wavelength_nm, anisotropy)
        tangents = tables.unit_tangents(len(sets), len(self.layers)) if gradient else ()
        found = self.answer(sets, detector or Detector.total(), tangents, least_samples, gradient=gradient)
        if degenerate == "raise":
            tables.refuse(found, sets, least_samples)
        return tables.evaluation(self, found, sets, gradient)

    def spectrum(
        self,
        stack: OpticalStack | None = None,
        *,
        degenerate: WhenDegenerate = "raise",
        least_samples: float = LEAST_SAMPLES,
    ) -> xr.Dataset:
        """The spectrum of a stack, under the names that `walk` uses.

        Parameters
        ----------
        stack
            Layers as recorded, with other coefficients, wavelengths within the band, or (in endless layers) other
            thicknesses; default: the stack recorded.
        degenerate
            What to do where weights degenerate, or the answer is not valid for another reason: "raise", "mark", or
            "walk": record those wavelengths anew, to the same error (needs the stack).
        least_samples
            Effective sample size that a valid answer needs.

        Returns
        -------
        Dataset on `wavelength`: reflectance, transmittance, lost, residual, each with its `_se`; specular; taken:
        absorbed in all layers together or removed by a factor of Algorithm 2 (the rest); ess, degeneracy, valid;
        reflectance_binned and transmittance_binned (_se) if there are bins. Attribute interpolation_bias: the
        largest error of the interpolation between anchors found half-way between them.

        Raises
        ------
        InputError
            A stack that differs in layers or indices, or wavelengths that cannot be answered.
        """
        if degenerate not in get_args(WhenDegenerate):
            raise InputError.of("degenerate", degenerate, "must be 'raise', 'mark' or 'walk'", "Name one.")
        if degenerate == "walk" and stack is None:
            raise InputError.of("stack", None, "is needed to walk again", "Give the stack.")
        sets = self.served if stack is None else tables.fitted(self, stack)
        return tables.spectrum(self, sets, stack, degenerate, least_samples)

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
        return tables.parameter_gradient(self, make, parameters, step, detector or Detector.total())

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
        sets = [tables.fitted(self, stack) for stack in also]
        return compress_ledger(self, tolerance, absorption_spread, scattering_spread, sets)

    def save(self, path: Path | str) -> None:
        """Write a NetCDF file that `load` reads.

        Raises
        ------
        EnvironmentProblem
            The file cannot be written.
        """
        file.save(self, Path(path))


def load(path: Path | str) -> Ledger:
    """Read a ledger that `Ledger.save` wrote.

    Raises
    ------
    DatasetError
        No such file, not a ledger, one of a later version, or a damaged one.
    """
    return file.load(path, Ledger)
