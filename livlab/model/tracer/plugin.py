"""The walk as a Mitsuba plugin, so that a scene written as dict or XML can name it: type "livlab_walk".

Mitsuba's `render` then calls the tracer; the picture's channels are the wavelengths, with their standard errors behind
them if `errors` is set, or linear sRGB.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from livlab.errors import InputError
from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import reading
from livlab.model.tissue.stack import OpticalStack
from livlab.model.tracer.body import Body
from livlab.model.tracer.render import render
from livlab.model.tracer.tracer import VARIANT
from livlab.model.tracer.variant import mitsuba
from livlab.units import FloatArray

NAME = "livlab_walk"

CHANNELS = ("wavelengths", "rgb")

Planner = Callable[[OpticalStack, float], OpticalStack]
"""From a stack and a tolerance to a stack without what does not matter."""


def register(variant: str = VARIANT, planner: Planner | None = None) -> Any:
    """Make "livlab_walk" known to Mitsuba under a variant, and give Mitsuba back.

    Its properties, all with defaults but `surfaces`:

    ========================  =========================================================================================
    surfaces                  ids of the shapes that bound the body, from the outside in, separated by commas
    tissue, state, part       preset, its state and variant (liver, ex_vivo, whole)
    reading                   thesis, consistent or measured
    wavelengths               nm, separated by commas, rising
    effects                   "all", or "planned": what the scene does not call for is left out, within `tolerance`
    tolerance                 how far planned effects may move the reflectance
    mm_per_unit               length of the scene's unit in mm
    spacing_mm                step of the distance grid if one surface bounds several layers (a mesh)
    estimator                 expected or analog
    channels                  "wavelengths", or "rgb": linear sRGB under D65 (CIE 1931)
    errors                    whether standard errors follow the channels (wavelengths only)
    ========================  =========================================================================================

    Parameters
    ----------
    variant
        A spectral variant of Mitsuba.
    planner
        What effects = "planned" asks: from a stack and a tolerance to the stack that the scene calls for; see
        `livlab.effects`.

    Raises
    ------
    EnvironmentProblem
        The variant cannot run here.

    Examples
    --------
    >>> mi = register()  # doctest: +SKIP
    >>> scene = mi.load_dict({"type": "scene", "integrator": {"type": "livlab_walk", "surfaces": "liver"}, ...})
    ... # doctest: +SKIP
    """
    mi = mitsuba(variant)
    if planner is not None:
        _planners[variant] = planner
    if variant in _registered:
        return mi

    class LivlabWalk(mi.ad.integrators.common.ADIntegrator):  # type: ignore[misc, name-defined]
        """The tracer behind Mitsuba's integrator interface; it has no derivatives."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.settings = _settings(props)

        def render(
            self,
            scene: Any,
            sensor: Any = 0,
            seed: Any = 0,
            spp: int = 0,
            develop: bool = True,
            evaluate: bool = True,
        ) -> Any:
            """Picture of a scene as a tensor (rows, columns, channels)."""
            if not isinstance(sensor, int):
                sensor = next(k for k, s in enumerate(scene.sensors()) if s is sensor or s == sensor)
            samples = int(spp) or int(scene.sensors()[sensor].sampler().sample_count())
            found = picture(scene, self.settings, sensor=sensor, seed=int(_number(seed)), spp=samples, variant=variant)
            return mi.TensorXf(np.ascontiguousarray(found, dtype=np.float32))

        def render_forward(self, *_: Any, **__: Any) -> Any:
            raise NotImplementedError("livlab_walk has no derivatives; fit by livlab's ledger")

        def render_backward(self, *_: Any, **__: Any) -> Any:
            raise NotImplementedError("livlab_walk has no derivatives; fit by livlab's ledger")

        def to_string(self) -> str:
            """Its settings."""
            return f"LivlabWalk[{self.settings}]"

    mi.register_integrator(NAME, LivlabWalk)
    _registered.add(variant)
    return mi


_registered: set[str] = set()
_planners: dict[str, Planner] = {}

DEFAULTS: dict[str, Any] = {
    "surfaces": "",
    "tissue": "liver",
    "state": "",
    "part": "whole",
    "reading": "measured",
    "wavelengths": "450,500,550,600,650,700",
    "effects": "all",
    "tolerance": 0.002,
    "mm_per_unit": 1.0,
    "spacing_mm": 0.75,
    "estimator": "expected",
    "channels": "wavelengths",
    "errors": False,
}


def _settings(props: Any) -> dict[str, Any]:
    """The plugin's properties, checked."""
    found = dict(DEFAULTS)
    for key in props.keys():  # noqa: SIM118 - Mitsuba's Properties do not iterate
        if key not in DEFAULTS:
            from livlab.config.errors import nearest

            hint = nearest(key, DEFAULTS) or f"Known: {', '.join(DEFAULTS)}."
            raise InputError.of(f"{NAME}.{key}", props[key], "is no property", hint)
        found[key] = type(DEFAULTS[key])(props[key])
    if not found["surfaces"]:
        raise InputError.of(f"{NAME}.surfaces", "", "must name the shapes that bound the body", "Give their ids.")
    for key, known in (("channels", CHANNELS), ("effects", ("all", "planned"))):
        if found[key] not in known:
            raise InputError.of(f"{NAME}.{key}", found[key], f"must be one of {', '.join(known)}", "Pick one.")
    found["wavelengths"] = _wavelengths(str(found["wavelengths"]))
    return found


def _wavelengths(text: str) -> FloatArray:
    try:
        grid = np.array([float(x) for x in text.replace(",", " ").split()])
    except ValueError:
        grid = np.zeros(0)
    if not grid.size or not np.isfinite(grid).all() or (np.diff(grid) <= 0).any() or grid[0] <= 0:
        raise InputError.of(f"{NAME}.wavelengths", text, "must be rising numbers in nm", "Write 500,550,600.")
    return grid


def _number(seed: Any) -> float:
    return float(np.ravel(np.array(seed))[0])


def picture(scene: Any, settings: dict[str, Any], *, sensor: int, seed: int, spp: int, variant: str) -> FloatArray:
    """(rows, columns, channels) of a loaded scene under the plugin's settings."""
    grid = settings["wavelengths"]
    stack = _stack(settings, grid, _planners.get(variant))
    surfaces = [s.strip() for s in settings["surfaces"].split(",")]
    distances = None
    if len(surfaces) == 1 and len(stack.layers) > 1:
        distances = _distances(scene, surfaces[0], settings["mm_per_unit"], settings["spacing_mm"])
    body = Body(stack, surfaces, distances, mm_per_unit=settings["mm_per_unit"])
    found = render(
        scene, grid, body=body, spp=spp, seed=seed, estimator=settings["estimator"], sensor=sensor, variant=variant
    )
    if settings["channels"] == "rgb":
        from livlab.model.colour import cie_rgb, colour_error

        if told := colour_error(found["radiance"].mean(["row", "column"])).attrs["told"]:
            warnings.warn(f"{NAME}, mean colour: {told}", UserWarning, stacklevel=2)
        return np.asarray(cie_rgb(found["radiance"]).to_numpy())
    parts = [found["radiance"].to_numpy()]
    if settings["errors"]:
        parts.append(found["radiance_se"].to_numpy())
    return np.concatenate(parts, axis=-1)


def _stack(settings: dict[str, Any], grid: FloatArray, planner: Planner | None) -> OpticalStack:
    tissue = load_preset(settings["tissue"], state=settings["state"] or None, variant=settings["part"])
    stack = optical_stack(tissue, reading(settings["reading"]), grid)
    if settings["effects"] == "all":
        return stack
    if planner is None:
        raise InputError.of(
            f"{NAME}.effects", "planned", "needs a planner", "Give one to register(planner=...), or use effects = all."
        )
    return planner(stack, float(settings["tolerance"]))


def _distances(scene: Any, name: str, mm_per_unit: float, spacing_mm: float) -> Any:
    """The distance field of a mesh of the scene, in mm."""
    from livlab.model.shapes.distance import distance_field
    from livlab.model.shapes.mesh import TriangleMesh

    shape = next((s for s in scene.shapes() if s.id() == name), None)
    if shape is None or not shape.is_mesh():
        raise InputError.of(
            f"{NAME}.surfaces", name, "must be a mesh, since it bounds several layers", "Give a mesh, or nested shapes."
        )
    vertices = np.array(shape.vertex_positions_buffer(), dtype=np.float64).reshape(-1, 3) * mm_per_unit
    faces = np.array(shape.faces_buffer(), dtype=np.int32).reshape(-1, 3)
    return distance_field(TriangleMesh(vertices, faces), spacing_mm)
