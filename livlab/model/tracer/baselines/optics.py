"""What the older models of appearance need to know of a material, and the same of a layered tissue."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.adding_doubling import adding_doubling
from livlab.model.transport.moments import reduced_coefficients
from livlab.units import FloatArray


@dataclass(frozen=True, eq=False)
class BaselineOptics:
    """What the older models need to know of a material, each (W,).

    Attributes
    ----------
    wavelength_nm
        Wavelengths in nm.
    reflectance
        Diffuse albedo ρ of Lambert's part, 0 to 1.
    absorption, reduced_scattering
        µ_a and µ_s' in 1/mm, for the dipole.
    n, n_above
        Refractive indices of the material and of what is around it.
    """

    wavelength_nm: FloatArray
    reflectance: FloatArray
    absorption: FloatArray
    reduced_scattering: FloatArray
    n: FloatArray
    n_above: FloatArray

    def __post_init__(self) -> None:
        size = np.shape(self.wavelength_nm)
        for name in ("wavelength_nm", "reflectance", "absorption", "reduced_scattering", "n", "n_above"):
            values = np.atleast_1d(np.asarray(getattr(self, name), dtype=np.float64))
            values = np.broadcast_to(values, np.broadcast_shapes(values.shape, size))
            low, high = (0.0, 1.0) if name == "reflectance" else (0.0, math.inf)
            if values.ndim != 1 or not np.all(np.isfinite(values) & (values >= low) & (values <= high)):
                raise InputError.of(
                    name, values.tolist(), f"must be finite, one a wavelength, {low:g} or more", "Mend it."
                )
            object.__setattr__(self, name, values)

    @property
    def normal_reflectance(self) -> FloatArray:
        """F₀ = ((n − n_above)/(n + n_above))² of the bare surface at normal incidence."""
        return np.asarray(((self.n - self.n_above) / (self.n + self.n_above)) ** 2)


def baseline_optics(stack: OpticalStack) -> BaselineOptics:
    """The older models' numbers for a layered tissue.

    The albedo is the tissue's diffuse reflectance at normal incidence, without the surface's own reflection
    (adding–doubling); the dipole takes its last layer, the parenchyma of a liver, as filling the body.

    Parameters
    ----------
    stack
        The tissue at the picture's wavelengths.

    Raises
    ------
    InputError
        As `adding_doubling`.
    """
    absorption, reduced = reduced_coefficients(stack.layers[-1])
    albedo = adding_doubling(stack, tolerance=1e-4)["reflectance"].to_numpy()
    return BaselineOptics(
        wavelength_nm=stack.wavelength_nm,
        reflectance=np.clip(albedo, 0.0, 1.0),
        absorption=absorption,
        reduced_scattering=reduced,
        n=stack.layers[-1].n,
        n_above=stack.n_above,
    )
