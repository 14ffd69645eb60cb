"""Mitsuba's reflection models as materials of a sphere: from plain tables, and their values in livlab's convention."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from livlab.errors import InputError
from livlab.model.tracer.variant import mitsuba
from livlab.units import FloatArray

RIG_VARIANT = "llvm_ad_rgb"
"""Variant in which spheres are rendered and materials evaluated: three channels in one pass."""


def material_dict(material: Mapping[str, Any]) -> dict[str, Any]:
    """A material as `mitsuba.load_dict` takes it, from a table as TOML or JSON write it.

    A list of three numbers stands for a colour: `{"type": "rgb", "value": [...]}`. A list of two pairs or more,
    `[[wavelength_nm, value], ...]`, stands for a spectrum.

    Raises
    ------
    InputError
        The table has no `type`, or holds what no material has.

    Examples
    --------
    >>> material_dict({"type": "diffuse", "reflectance": [0.5, 0.4, 0.3]})["reflectance"]
    {'type': 'rgb', 'value': [0.5, 0.4, 0.3]}
    """
    if not isinstance(material.get("type"), str):
        raise InputError.of(
            "material.type", material.get("type"), "must name a Mitsuba BSDF", 'Write type = "diffuse".'
        )
    return {key: _plain(f"material.{key}", value) for key, value in material.items()}


def load_material(material: Mapping[str, Any], variant: str = RIG_VARIANT) -> Any:
    """The Mitsuba BSDF of a table, if a sphere of it can be measured.

    Raises
    ------
    InputError
        Mitsuba does not know it, it lets light through, or it reflects in single directions only.
    EnvironmentProblem
        The variant cannot run here.
    """
    mi = mitsuba(variant)
    try:
        bsdf = mi.load_dict(material_dict(material), optimize=False)
    except (RuntimeError, ValueError, TypeError) as error:
        raise InputError.of(
            "material", dict(material), f"is not taken by Mitsuba ({_last_line(error)})", "Mend the table."
        ) from error
    if not isinstance(bsdf, mi.BSDF):
        raise InputError.of("material.type", material["type"], "is no BSDF", "Name one, such as 'roughconductor'.")
    flags = bsdf.flags()
    if mi.has_flag(flags, mi.BSDFFlags.Transmission):
        raise InputError.of("material.type", material["type"], "lets light through", "Take an opaque material.")
    if not mi.has_flag(flags, mi.BSDFFlags.Smooth):
        raise InputError.of(
            "material.type", material["type"], "is a perfect mirror: no BRDF to measure", "Take a rough material."
        )
    return bsdf


def evaluate(material: Mapping[str, Any], wi: FloatArray, wo: FloatArray, *, variant: str = RIG_VARIANT) -> FloatArray:
    """BRDF of a material in 1/sr, without cosine.

    Mitsuba's `BSDF.eval` takes the camera's direction as `wi`, the light's as `wo`, and multiplies by the light's
    cosine; here `wi` points to the light, as everywhere in livlab, and the cosine is divided out.

    Parameters
    ----------
    material
        As `material_dict` takes it.
    wi, wo
        (n, 3) unit vectors to light and eye in the local frame, z along the normal.

    Returns
    -------
    (n, channels) array
        0 where either direction lies below the surface.
    """
    mi = mitsuba(variant)
    bsdf = load_material(material, variant)
    wi, wo = np.atleast_2d(np.asarray(wi, float)), np.atleast_2d(np.asarray(wo, float))
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(np.ascontiguousarray(wo.T, dtype=np.float32))
    si.t = 1.0
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(mi.Normal3f(0, 0, 1))
    si.wavelengths = mi.Color0f() if "spectral" not in variant else si.wavelengths
    to_light = mi.Vector3f(np.ascontiguousarray(wi.T, dtype=np.float32))
    value = np.array(bsdf.eval(mi.BSDFContext(), si, to_light), dtype=np.float64)
    value = value.reshape(-1, len(wi)).T if value.ndim != 1 else value[:, None]
    above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
    return np.where(above[:, None], value / np.where(above, wi[:, 2], 1.0)[:, None], 0.0)


def _plain(field: str, value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(f"{field}.{k}", v) for k, v in value.items()}
    if isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, float):
        if not np.isfinite(value):
            raise InputError.of(field, value, "must be finite", "Mend the number.")
        return value
    if isinstance(value, (list, tuple)):
        if len(value) == 3 and all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in value):
            return {"type": "rgb", "value": [float(x) for x in value]}
        if len(value) >= 2 and all(isinstance(x, (list, tuple)) and len(x) == 2 for x in value):
            return {"type": "spectrum", "value": [(float(a), float(b)) for a, b in value]}
    raise InputError.of(
        field, value, "must be a number, a text, a colour of three numbers, a spectrum or a table", "Mend it."
    )


def _last_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1].removeprefix("…").strip() if lines else type(error).__name__
