"""What a data set of BRDF samples looks like: names, units, conventions; and how to make and check one."""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import xarray as xr

from livlab.brdf.angles import half_angles, polar_angle, unit_directions
from livlab.errors import InputError

FloatArray = npt.NDArray[np.float64]

CONVENTIONS = {
    "kind": "BRDF samples",
    "quantity": "bidirectional reflectance distribution function without the cosine",
    "value_units": "1/sr",
    "wi": "unit vector from the surface to the light",
    "wo": "unit vector from the surface to the eye",
    "frame": "local, right-handed: z is the surface normal, y points to the pole of the sphere, x = y cross z",
    "angles": "radians; theta_h, theta_d, phi_d after Rusinkiewicz 1998, phi_d of wi in (-pi, pi]",
}
"""Attributes of every data set of samples."""

ATTRS: dict[str, dict[str, str]] = {
    "wi": {"units": "1", "long_name": "direction to the light", "frame": "local"},
    "wo": {"units": "1", "long_name": "direction to the eye", "frame": "local"},
    "value": {"units": "1/sr", "long_name": "BRDF without cosine"},
    "standard_error": {"units": "1/sr", "long_name": "standard error of value; NaN where the noise is not known"},
    "theta_i": {"units": "rad", "long_name": "angle between normal and light"},
    "theta_o": {"units": "rad", "long_name": "angle between normal and eye"},
    "theta_h": {"units": "rad", "long_name": "angle between normal and half vector"},
    "theta_d": {"units": "rad", "long_name": "angle between light and half vector"},
    "phi_d": {"units": "rad", "long_name": "azimuth of the light about the half vector"},
    "pixel_solid_angle": {"units": "sr", "long_name": "solid angle of the pixel from the camera"},
    "source_solid_angle": {"units": "sr", "long_name": "solid angle of the source from the surface"},
    "area": {"units": "mm2", "long_name": "area of the surface that the pixel sees"},
    "row": {"units": "pixel", "long_name": "row of the pixel, counted from 0 at the top"},
    "column": {"units": "pixel", "long_name": "column of the pixel, counted from 0 at the left"},
    "light": {"long_name": "index of the light"},
}

ANGLES = ("theta_i", "theta_o", "theta_h", "theta_d", "phi_d")


def angles_of(wi: FloatArray, wo: FloatArray) -> dict[str, FloatArray]:
    """The five angles of pairs of directions, by the names they have in a data set."""
    half = half_angles(wi, wo)
    return dict(zip(ANGLES, (polar_angle(wi), polar_angle(wo), half.theta_h, half.theta_d, half.phi_d), strict=True))


def sample_dataset(
    wi: npt.ArrayLike,
    wo: npt.ArrayLike,
    value: npt.ArrayLike,
    *,
    standard_error: npt.ArrayLike | None = None,
    channels: Sequence[object] | None = None,
    extra: Mapping[str, npt.ArrayLike] | None = None,
    attrs: Mapping[str, object] | None = None,
) -> xr.Dataset:
    """A data set of samples from bare arrays.

    Parameters
    ----------
    wi, wo : (n, 3) array
        Unit vectors in the local frame, to the light and to the eye.
    value, standard_error : (n,) or (n, channel) array
        1/sr, without cosine.
    channels
        Names of the channels.
    extra
        More (n,) variables, such as `light` or `source_solid_angle`.
    attrs
        More attributes, such as where the samples come from.

    Raises
    ------
    InputError
        Directions not of unit length, counts that differ.
    """
    first, second = unit_directions("wi", wi), unit_directions("wo", wo)
    numbers = np.asarray(value, dtype=np.float64)
    if numbers.ndim == 1:
        numbers = numbers[:, None]
    count = len(first)
    if first.shape != (count, 3) or second.shape != first.shape or numbers.ndim != 2 or len(numbers) != count:
        raise InputError.of(
            "samples",
            f"wi {first.shape}, wo {second.shape}, value {numbers.shape}",
            "must have one row for each sample",
            "Give wi and wo as (n, 3) and value as (n, channel).",
        )
    error = np.broadcast_to(np.nan, numbers.shape) if standard_error is None else np.asarray(standard_error, float)
    if error.ndim == 1:
        error = error[:, None]
    if error.shape != numbers.shape:
        raise InputError.of(
            "standard_error", error.shape, f"must have the shape of value, {numbers.shape}", "Leave it out if unknown."
        )
    return assemble(first, second, numbers, error, channels, angles_of(first, second) | dict(extra or {}), attrs or {})


def assemble(
    wi: FloatArray,
    wo: FloatArray,
    value: FloatArray,
    error: FloatArray,
    channels: Sequence[object] | None,
    columns: Mapping[str, npt.ArrayLike],
    attrs: Mapping[str, object],
) -> xr.Dataset:
    """Put arrays that are known to fit into a data set, without copies."""
    names = list(range(value.shape[1])) if channels is None else list(channels)
    data = {
        "wi": (("sample", "xyz"), wi, ATTRS["wi"]),
        "wo": (("sample", "xyz"), wo, ATTRS["wo"]),
        "value": (("sample", "channel"), value, ATTRS["value"]),
        "standard_error": (("sample", "channel"), error, ATTRS["standard_error"]),
    }
    coords = {name: ("sample", values, ATTRS.get(name, {})) for name, values in columns.items()}
    return xr.Dataset(data, coords={"xyz": ["x", "y", "z"], "channel": names, **coords}, attrs={**CONVENTIONS, **attrs})


def check_samples(samples: xr.Dataset) -> None:
    """See that a data set holds samples as this module describes them.

    Raises
    ------
    InputError
        A variable or a dimension is missing, or a direction is not of unit length.
    """
    for name, dims in (("wi", ("sample", "xyz")), ("wo", ("sample", "xyz")), ("value", ("sample", "channel"))):
        if name not in samples or samples[name].dims != dims:
            raise InputError.of(
                f"samples.{name}",
                samples[name].dims if name in samples else "absent",
                f"must have the dimensions {dims}",
                "Use livlab.brdf.sphere.extract, livlab.brdf.samples.sample_dataset or a reader of livlab.brdf.files.",
            )
    unit_directions("samples.wi", samples["wi"].values)
    unit_directions("samples.wo", samples["wo"].values)
