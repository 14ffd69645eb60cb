"""A virtual goniometer: a flat endless sample, a collimated light, a detector at every angle.

The walk's light is counted in bins of exit angle and azimuth, as a detector with an aperture counts it; divided by the
incident light and the bin's projected solid angle it is the BRDF, f = dL/dE (Nicodemus et al. 1977), the detector's
mean of it. The mirror reflection of a smooth surface is a delta: it is given apart, as a reflectance.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import xarray as xr

from livlab.errors import InputError
from livlab.model.tissue.stack import REDIRECT_MEAN, OpticalStack
from livlab.units import FloatArray


@dataclass(frozen=True)
class Detectors:
    """Bins of the detector's polar angle and azimuth, each centred on the angle it is named by.

    Attributes
    ----------
    theta_step_deg
        Polar step; bins at 0, step, 2 step, …, 90°, the first and the last of half width. Must divide 90.
    phi_step_deg
        Step in azimuth; bins at 0 (the light's side), step, …, 180° (the mirror's side). Must divide 180.
    """

    theta_step_deg: float = 5.0
    phi_step_deg: float = 30.0

    def __post_init__(self) -> None:
        for name, step, whole in (
            ("theta_step_deg", self.theta_step_deg, 90.0),
            ("phi_step_deg", self.phi_step_deg, 180.0),
        ):
            if not (step > 0 and math.isclose(whole / step, round(whole / step)) and whole / step >= 1):
                raise InputError.of(f"detectors.{name}", step, f"must divide {whole:g}", "Take 5, 10, 15 or so.")

    @property
    def theta(self) -> FloatArray:
        """(T,) centres in radians."""
        return np.radians(np.linspace(0.0, 90.0, round(90.0 / self.theta_step_deg) + 1))

    @property
    def phi(self) -> FloatArray:
        """(P,) centres in radians."""
        return np.radians(np.linspace(0.0, 180.0, round(180.0 / self.phi_step_deg) + 1))

    @property
    def theta_edges(self) -> FloatArray:
        """(T + 1,) edges in radians."""
        return _edges(self.theta)

    @property
    def phi_edges(self) -> FloatArray:
        """(P + 1,) edges in radians."""
        return _edges(self.phi)

    @property
    def projected_solid_angle(self) -> FloatArray:
        """(T, P) ∫ cos θ dΩ over each bin, left and right of the plane of incidence together; Σ = π."""
        polar = np.diff(np.sin(self.theta_edges) ** 2) / 2.0
        return np.asarray(polar[:, None] * (2.0 * np.diff(self.phi_edges)))


def goniometer(
    stack: OpticalStack,
    theta_i: Sequence[float] | FloatArray,
    detectors: Detectors | None = None,
    *,
    samples: int = 1_000_000,
    seed: int = 0,
    variant: Literal["llvm", "cuda"] = "llvm",
    progress: Callable[[float], None] | None = None,
) -> xr.Dataset:
    """BRDF of a flat stack, resolved in azimuth, by random walk.

    Parameters
    ----------
    stack
        The layers, endless sideways.
    theta_i
        Angles of incidence in radians, in [0, π/2).
    detectors
        Default: every 5° in θ_o and 30° in φ.
    samples
        Photons at each wavelength and angle of incidence.
    seed
        Each angle of incidence has a stream of its own, the same whatever other angles there are.
    progress
        Called with the fraction done; it may raise to stop.

    Returns
    -------
    xr.Dataset
        `brdf` (wavelength, theta_i, theta_o, phi) in 1/sr without cosine and without the mirror reflection, `brdf_se`;
        `reflectance`, `reflectance_se` (wavelength, theta_i): the hemisphere's, as the walk counts it, and
        `reflectance_systematic`: what photons given up could have added; `integral`:
        Σ brdf · projected solid angle, which equals it; `specular`: the mirror reflection. φ = 0 is the light's side.

    Raises
    ------
    InputError
        An angle out of bounds, or fewer than one sample.
    EnvironmentProblem
        The walk cannot run here.
    """
    from livlab.model.transport.source import Source
    from livlab.model.transport.tally import Tally
    from livlab.model.transport.walk.walk import walk

    detectors = detectors or Detectors()
    angles = np.atleast_1d(np.asarray(theta_i, dtype=np.float64))
    tally = Tally(theta_edges=tuple(detectors.theta_edges), phi_edges=tuple(detectors.phi_edges))
    sources = [Source.collimated(float(a)) for a in angles]
    weight = detectors.projected_solid_angle
    made = []
    for k, (angle, source) in enumerate(zip(angles, sources, strict=True)):
        told = None if progress is None else _part(progress, k, len(angles))
        own = _seed(seed, angle)
        r = walk(stack, source=source, tally=tally, samples=samples, seed=own, variant=variant, progress=told)
        made.append(
            xr.Dataset(
                {
                    "brdf": r["reflectance_directed"] / weight,
                    "brdf_se": r["reflectance_directed_se"] / weight,
                    "integral": r["reflectance_directed"].sum(("theta_o", "phi")),
                    "reflectance": r["reflectance"],
                    "reflectance_se": r["reflectance_se"],
                    "reflectance_systematic": r["unfinished_share"],
                    "specular": r["specular"],
                },
                attrs={"seconds": r.attrs["seconds"], "compile_seconds": r.attrs["compile_seconds"]},
            )
        )
    seconds = {name: sum(float(m.attrs[name]) for m in made) for name in ("seconds", "compile_seconds")}
    out = xr.concat(made, xr.DataArray(angles, dims="theta_i", name="theta_i"), combine_attrs="drop")
    out = out.assign_coords(
        theta_o=("theta_o", detectors.theta, {"units": "rad", "edges": detectors.theta_edges}),
        phi=("phi", detectors.phi, {"units": "rad", "edges": detectors.phi_edges}),
    )
    out["theta_i"].attrs = {"units": "rad"}
    out = out.transpose("wavelength", "theta_i", "theta_o", "phi", missing_dims="ignore")
    for name in out.data_vars:
        out[name].attrs = {"units": "1/sr" if str(name).startswith("brdf") else "1"}
    out.attrs = {
        "samples": samples,
        "seed": seed,
        "variant": variant,
        **seconds,
        "convention": "phi = 0: the light's side; no cosine; mirror reflection apart",
    }
    return out.drop_vars("layer", errors="ignore")


def unoriented(stack: OpticalStack) -> OpticalStack:
    """The stack with Algorithm 2's azimuth counted from an axis drawn anew at each redirection.

    The factor |cos θ| of Nunes 2019, Algorithm 2, depends on an azimuth whose origin the text does not name. Counted
    from one axis of the sample it favours directions along that axis, and a BRDF would depend on how the sample is
    turned. From an axis drawn anew the factor is its mean, on the albedo, and no direction is special: as the tracer
    has it, whose bodies have no frame of their own.

    >>> from livlab.model.tissue.phase.functions import Isotropic
    >>> from livlab.model.tissue.stack import plain_stack
    >>> unoriented(plain_stack([(1.4, 1.0, 1.0, 1.0, Isotropic())])).layers[0].interactions[1].redirect
    'none'
    """
    layers = []
    for layer in stack.layers:
        parts = tuple(
            replace(i, albedo=i.albedo * REDIRECT_MEAN[i.redirect], redirect="none") for i in layer.interactions
        )
        layers.append(replace(layer, interactions=parts))
    return replace(stack, layers=tuple(layers))


def collinear(measured: xr.Dataset) -> xr.Dataset:
    """The detector where the light is: f(θ, θ, φ = 0) at each angle of incidence.

    Raises
    ------
    InputError
        An angle of incidence has no detector bin centred on it.
    """
    known = measured["theta_o"].to_numpy()
    places = []
    for angle in measured["theta_i"].to_numpy():
        k = int(np.abs(known - angle).argmin())
        if abs(known[k] - angle) > 1e-6:
            raise InputError.of(
                "theta_i", float(np.degrees(angle)), "has no detector centred on it", "Take a multiple of the step."
            )
        places.append(k)
    at = xr.DataArray(places, dims="theta_i")
    picked = measured[["brdf", "brdf_se"]].isel(theta_o=at, phi=0)
    return picked.drop_vars(["theta_o", "phi"])


def _edges(centres: FloatArray) -> FloatArray:
    middle = 0.5 * (centres[1:] + centres[:-1])
    return np.concatenate([centres[:1], middle, centres[-1:]])


def _seed(seed: int, angle: float) -> int:
    digest = hashlib.sha256(f"{seed}:{float(angle):.9f}".encode()).digest()
    return int.from_bytes(digest[:4], "big") >> 1


def _part(progress: Callable[[float], None], k: int, count: int) -> Callable[[float], None]:
    return lambda share: progress((k + share) / count)
