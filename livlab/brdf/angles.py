"""Angles of a pair of directions: local frames, spherical angles, and the half-angle coordinates of Rusinkiewicz.

All directions are unit vectors in a local frame whose z axis is the surface normal; `wi` points to the light, `wo` to
the eye. Every angle comes from an arc tangent of two lengths, never from an arc cosine, so that nothing is lost near
the normal or near retroreflection.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from livlab.errors import InputError

FloatArray = npt.NDArray[np.float64]

UNIT_TOLERANCE = 1e-6
"""How far the length of a direction may lie from 1: float32 files pass, directions in degrees do not."""


class HalfAngles(NamedTuple):
    """Rusinkiewicz's coordinates in radians: θ_h in [0, π/2], θ_d in [0, π/2], φ_d in (−π, π], φ_h in (−π, π]."""

    theta_h: FloatArray
    theta_d: FloatArray
    phi_d: FloatArray
    phi_h: FloatArray


def unit_directions(name: str, value: npt.ArrayLike) -> FloatArray:
    """Directions (..., 3) in float64, of length 1 to rounding.

    Raises
    ------
    InputError
        The last dimension is not 3, or a direction is not finite or not of unit length.
    """
    array = np.asarray(value, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise InputError.of(name, array.shape, "directions have three components in the last dimension", "give x, y, z")
    lengths = np.sqrt(np.einsum("...i,...i->...", array, array))
    wrong = ~(np.abs(lengths - 1) <= UNIT_TOLERANCE)
    if np.any(wrong):
        first = tuple(int(i[0]) for i in np.nonzero(wrong)) if wrong.ndim else ()
        raise InputError.of(
            f"{name}{list(first) if first else ''}",
            array[first].tolist(),
            f"must be a unit vector, its length is {lengths[first]:.6g}",
            "Divide each direction by its length.",
        )
    return array


def local_frames(normals: npt.ArrayLike, axis: npt.ArrayLike = (0.0, 1.0, 0.0)) -> FloatArray:
    """Right-handed frames (..., 3, 3) on a surface: rows x, y, z with z the normal and y towards the pole `axis`.

    On a globe whose axis is `axis`, x points east along the parallel and y north along the meridian. At the poles,
    where neither exists, x is a fixed direction across the axis. `frames @ v` takes world vectors into the frame.

    Parameters
    ----------
    normals : (..., 3) array
        Unit normals.
    axis : (3,) array
        Direction of the pole, any length.
    """
    z = np.asarray(normals, dtype=np.float64)
    pole = np.asarray(axis, dtype=np.float64)
    pole = pole / np.linalg.norm(pole)
    spare = np.zeros(3)
    spare[np.argmin(np.abs(pole))] = 1.0
    x = np.cross(pole, z)
    length = np.linalg.norm(x, axis=-1, keepdims=True)
    fallback = np.cross(spare, pole)
    fallback /= np.linalg.norm(fallback)
    near_pole = length < 1e-9
    x = np.where(near_pole, fallback, x / np.where(near_pole, 1.0, length))
    # The fallback is only across the axis, not across a normal that lies a hair beside it.
    x = x - z * np.sum(x * z, axis=-1, keepdims=True)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=-2)


def polar_angle(directions: npt.ArrayLike) -> FloatArray:
    """Angle (...) between directions (..., 3) and the normal, in [0, π]."""
    w = np.asarray(directions, dtype=np.float64)
    return np.arctan2(np.hypot(w[..., 0], w[..., 1]), w[..., 2])


def direction(theta: npt.ArrayLike, phi: npt.ArrayLike) -> FloatArray:
    """Unit vector (..., 3) at polar angle θ from the normal and azimuth φ from x.

    >>> direction(0.0, 1.0)
    array([0., 0., 1.])
    """
    theta, phi = np.broadcast_arrays(np.asarray(theta, dtype=np.float64), np.asarray(phi, dtype=np.float64))
    sine = np.sin(theta)
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)], axis=-1)


def half_angles(wi: npt.ArrayLike, wo: npt.ArrayLike) -> HalfAngles:
    """Half-angle coordinates of pairs of directions (Rusinkiewicz 1998, section 3).

    h = (wi + wo)/|wi + wo| has polar angle θ_h and azimuth φ_h; rotating h to the normal, by −φ_h about z and then by
    −θ_h about y, takes wi to the difference vector d with polar angle θ_d and azimuth φ_d. Swapping wi and wo adds π to
    φ_d; mirroring the surface turns φ_d into −φ_d.

    Parameters
    ----------
    wi, wo : (..., 3) array
        Unit vectors in the local frame. Opposite vectors have no half vector: θ_h and the azimuths are NaN.

    Examples
    --------
    >>> angles = half_angles(direction(0.5, 0.0), direction(0.1, 0.0))
    >>> [round(float(a), 9) for a in angles]
    [0.3, 0.2, 0.0, 0.0]
    """
    a, b = np.asarray(wi, dtype=np.float64), np.asarray(wo, dtype=np.float64)
    total, difference = a + b, a - b
    length = np.linalg.norm(total, axis=-1)
    theta_d = np.arctan2(np.linalg.norm(difference, axis=-1), length)
    with np.errstate(invalid="ignore", divide="ignore"):
        h = total / length[..., None]
        across = np.hypot(h[..., 0], h[..., 1])
        theta_h = np.arctan2(across, h[..., 2])
        phi_h = np.arctan2(h[..., 1], h[..., 0])
        level = across < 1e-300
        cos_phi = np.where(level, 1.0, h[..., 0] / across)
        sin_phi = np.where(level, 0.0, h[..., 1] / across)
    # d lies across h, so half the difference of the two directions has its x and y without any loss.
    along_theta = (difference[..., 0] * cos_phi + difference[..., 1] * sin_phi) * h[..., 2] - difference[
        ..., 2
    ] * across
    along_phi = difference[..., 1] * cos_phi - difference[..., 0] * sin_phi
    phi_d = np.arctan2(along_phi, along_theta)
    return HalfAngles(theta_h, theta_d, phi_d, np.where(level, 0.0, phi_h))


def from_half_angles(
    theta_h: npt.ArrayLike, theta_d: npt.ArrayLike, phi_d: npt.ArrayLike, phi_h: npt.ArrayLike = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Directions wi and wo (..., 3) of half-angle coordinates: the inverse of `half_angles`.

    wo is wi mirrored at h. Coordinates may name directions below the surface; look at their z.

    Examples
    --------
    >>> wi, wo = from_half_angles(0.2, 0.5, 1.0)
    >>> [round(float(a), 9) for a in half_angles(wi, wo)[:3]]
    [0.2, 0.5, 1.0]
    """
    th, td, pd, ph = np.broadcast_arrays(*(np.asarray(v, dtype=np.float64) for v in (theta_h, theta_d, phi_d, phi_h)))
    h = direction(th, ph)
    east = np.stack([np.cos(th) * np.cos(ph), np.cos(th) * np.sin(ph), -np.sin(th)], axis=-1)
    north = np.stack([-np.sin(ph), np.cos(ph), np.zeros_like(ph)], axis=-1)
    across = np.sin(td)[..., None] * (np.cos(pd)[..., None] * east + np.sin(pd)[..., None] * north)
    along = np.cos(td)[..., None] * h
    return along + across, along - across
