"""From photographs to samples of the BRDF, with what the pictures show to be wrong and what was left uncorrected."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from livlab.acquire.photographs.light_check import LightCheck
from livlab.acquire.photographs.light_table import at_pixels, judged, shading_of, thinned_pixels
from livlab.acquire.photographs.linearity import Linearity
from livlab.acquire.photographs.outline import FloatArray
from livlab.acquire.photographs.rig import MOST_SAMPLES, PhotographedRig
from livlab.brdf.rig import rig_variables
from livlab.brdf.sphere import MAX_ANGLE, Extraction
from livlab.errors import InputError

_DARK_COSINE = -0.1
_STRAY = 0.01
_UNEVEN = 0.5


@dataclass(frozen=True, eq=False)
class Shadow:
    """What the attached shadow of a sphere under one light shows, where nothing should be seen.

    Attributes
    ----------
    level
        Mean radiance there over the mean radiance of the lit part.
    slope
        (3,) how it grows with the normal, over its mean; 1 where a half space shines, 0 where a veil lies over all.
    background
        Level beside the sphere over that of the lit part.
    pixels
        In the shadow.
    """

    level: float
    slope: FloatArray
    background: float
    pixels: int


@dataclass(frozen=True, eq=False)
class Extracted:
    """Samples, and what is to be said about them.

    Attributes
    ----------
    samples
        As `livlab.brdf.sphere.extract` gives them, thinned to pixels of a lattice.
    stride
        Every n-th row and column was kept.
    shadows
        For each light; None where its shadow is not in view.
    linearity
        The verdict of the sphere itself, if it is matte.
    lights
        What the pictures say about the lights; None where too few pixels are usable.
    unresolved
        Faults that no calibration was given for, with what the pictures say about them.
    warnings
        What is likely wrong.
    """

    samples: xr.Dataset
    stride: int
    shadows: tuple[Shadow | None, ...]
    linearity: Linearity | None
    lights: LightCheck | None
    unresolved: tuple[str, ...]
    warnings: tuple[str, ...]


def extract_samples(
    rig: PhotographedRig,
    *,
    most: int = MOST_SAMPLES,
    max_angle: float = MAX_ANGLE,
    grazing_px: float = 0.8,
    max_clipped: float = 0.02,
    skip_empty: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Extracted:
    """Samples of the BRDF from photographs, one picture in memory at a time.

    Parameters
    ----------
    rig
        The photographs.
    most
        Samples that are kept at most: of every n-th row and column, n as small as that allows.
    max_angle, grazing_px
        As `livlab.brdf.sphere.extract`.
    max_clipped
        Share of a light's pixels that may be clipped in every exposure.
    skip_empty
        Leave out lights that give no sample, for instance from behind, in place of refusing them.
    progress
        Called with the lights done and all of them.

    Raises
    ------
    InputError
        What `livlab.brdf.sphere.extract` refuses, and overexposed pictures.
    """
    stride = _stride(rig, most, max_angle)
    extraction = Extraction(
        rig.images,
        rig.camera,
        rig.lights,
        rig.sphere,
        white=rig.white,
        variance=rig.variance,
        mask=_lattice(rig, stride),
        saturation=np.inf,
        max_angle=max_angle,
        grazing_px=grazing_px,
        empty_lights="skip" if skip_empty else "refuse",
        cut=rig.cut,
    )
    look = _Shadows(rig)
    parts, tallies, shadows, kept = [], [], [], []
    try:
        for part in extraction.by_light():
            k = int(part["light"].values[0])
            clipped = _check_clipped(rig, k, part, max_clipped)
            parts.append(part.drop_vars([n for n in part.variables if "sample" not in part[n].dims and n != "channel"]))
            tallies.append({**{n: int(part[n][0]) for n in _COUNTS}, "clipped": clipped})
            shadows.append(look(k))
            kept.append(k)
            if progress is not None:
                progress(k + 1, len(rig.lights))
    except InputError as error:
        if "no sample" not in error.message:
            raise
        check = look.judged()
        why = " ".join(check.warnings if check is not None and check.misplaced else ())
        raise InputError(error.message, remedy=why or f"{error.remedy} (--skip-empty)") from error
    if not parts:
        raise InputError.of("lights", len(rig.lights), "none gives a sample", "Check where the lights stand.")
    samples = xr.concat(
        parts, dim="sample", data_vars="minimal", coords="minimal", compat="override", join="override"
    ).assign_attrs(parts[0].attrs, stride=stride, rig=rig.name)
    samples = samples.assign_attrs(lamp_size="given" if rig.sized else "not given")
    samples = _described(rig, samples, dict(zip(kept, tallies, strict=True)))
    check = look.judged()
    misplaced = check is not None and check.misplaced
    samples = _scaled(rig, samples, check.warnings[0] if misplaced and check else "See that the lights were on.")
    matte = None
    if not misplaced:
        with contextlib.suppress(InputError):  # too little of it is lit
            matte = rig.matte_linearity()
    warnings = _warnings(rig, check, shadows, matte)
    return Extracted(samples, stride, tuple(shadows), matte, check, tuple(_unresolved(rig, shadows)), warnings)


_COUNTS = ("used", "dropped_not_finite", "dropped_masked", "dropped_saturated")


def _described(rig: PhotographedRig, samples: xr.Dataset, tallies: Mapping[int, Mapping[str, int]]) -> xr.Dataset:
    """The samples with the rig that they were taken with and, by light, what became of its pixels."""
    every = [light if light.intensity.size > 1 else _spread(light, len(rig.channels)) for light in rig.lights]
    samples = samples.assign(rig_variables(rig.camera, every, rig.sphere))
    index = np.full((len(rig.lights), len(_COUNTS) + 1), 0)
    for k, tally in tallies.items():
        index[k] = list(tally.values())
    for n, name in enumerate((*_COUNTS, "clipped")):
        samples[name] = ("light_index", index[:, n])
    return samples


def _spread(light: Any, count: int) -> Any:
    from dataclasses import replace

    return replace(light, intensity=np.broadcast_to(light.intensity, count).copy())


def _scaled(rig: PhotographedRig, samples: xr.Dataset, dark: str) -> xr.Dataset:
    """Without a white reference the scale is free: it is set so that the brightest channel reflects a half on average.

    A fit would otherwise run into the bounds of an albedo. `dark` is what to do where all is black.
    """
    if np.isfinite(rig.white_sd):
        return samples.assign_attrs(scale="absolute, by a white reference")
    weight = np.cos(samples["theta_i"].values) * np.cos(samples["theta_o"].values)
    mean = np.average(samples["value"].values, axis=0, weights=weight)
    if not mean.max() > 0:
        raise InputError.of("pictures", "black", "are dark wherever the lights should light the sphere", dark)
    factor = 0.5 / np.pi / float(mean.max())
    told = f"arbitrary: no white reference; multiplied by {factor:.6g} to a mean of 0.5/pi in the brightest channel"
    return samples.assign(
        value=samples["value"] * factor, standard_error=samples["standard_error"] * factor
    ).assign_attrs(scale=told)


def _stride(rig: PhotographedRig, most: int, max_angle: float) -> int:
    """Lattice step at which the lit pixels of all lights are at most `most`."""
    if most < 100:
        raise InputError.of("most", most, "must be >= 100", "Leave it out.")
    rows, columns = rig.inside(20_000, max_angle)
    hits = rig.sphere.meet(*rig.camera.rays(columns, rows))
    lit = sum(
        int(np.count_nonzero(np.einsum("ni,ni->n", light.at(hits.points_mm)[0], hits.normals) >= np.cos(max_angle)))
        for light in rig.lights
    )
    curve = rig.sphere.outline(rig.camera)
    area = float(np.prod(np.ptp(curve, axis=0))) * np.pi / 4
    share = area * np.sin(max_angle) ** 2 / max(len(rows), 1)
    return max(int(np.ceil(np.sqrt(lit * share / most))), 1)


def _lattice(rig: PhotographedRig, stride: int) -> NDArray[np.bool_]:
    """(rows, columns) True at every `stride`-th usable pixel."""
    lattice = np.zeros((rig.camera.height, rig.camera.width), dtype=bool)
    lattice[::stride, ::stride] = True
    if rig.mask is not None:
        lattice &= rig.mask
    return lattice


def _check_clipped(rig: PhotographedRig, k: int, part: xr.Dataset, most: float) -> int:
    lost = int(part["dropped_not_finite"][0])
    told = rig.frames.told.get(k)
    all_lit = lost + int(part["used"][0])
    if told is not None and told.clipped > 0 and lost > most * all_lit:
        raise InputError.of(
            f"pictures of light {k}",
            f"{lost} of {all_lit} pixels clipped",
            f"is overexposed: at most {most:.3g} of a light's pixels may be clipped in every exposure",
            "Expose shorter, add a shorter exposure to merge, or allow it (--max-clipped) and lose the highlight.",
        )
    return lost if told is not None and told.clipped > 0 else 0


class _Shadows:
    """The attached shadow and the surroundings in each picture."""

    def __init__(self, rig: PhotographedRig) -> None:
        self.rig = rig
        self.rows, self.columns = rig.inside(20_000, float(np.deg2rad(80.0)))
        self.hits = rig.sphere.meet(*rig.camera.rays(self.columns, self.rows))
        curve = rig.sphere.outline(rig.camera)
        middle = curve.mean(axis=0)
        ring = np.concatenate([middle + f * (curve - middle) for f in (1.1, 1.15, 1.2)])
        inside = np.all((ring >= 0) & (ring <= [rig.camera.width - 1, rig.camera.height - 1]), axis=1)
        self.ring = np.round(ring[inside]).astype(int)
        self.few = thinned_pixels(rig)
        self.kept: dict[int, tuple[FloatArray, FloatArray]] = {}

    def at(self, k: int) -> NDArray[np.floating]:
        """Radiance of the pixels that are looked at, mean over the channels."""
        return np.asarray(self.rig.frames[k].value[self.rows, self.columns].mean(axis=-1))

    def _few(self, k: int) -> tuple[FloatArray, FloatArray]:
        """Radiance and variance of the pixels by which lights are judged."""
        if k not in self.kept:
            self.kept[k] = at_pixels(self.rig.frames[k], *self.few)
        return self.kept[k]

    def judged(self) -> LightCheck | None:
        """What the shading of all pictures says about the lights."""
        every = [self._few(k) for k in range(len(self.rig.lights))]
        return judged(self.rig, shading_of(self.rig, *self.few, [v for v, _ in every], [n for _, n in every]))

    def __call__(self, k: int) -> Shadow | None:
        self._few(k)
        towards, _ = self.rig.lights[k].at(self.hits.points_mm)
        cosine = np.einsum("ni,ni->n", towards, self.hits.normals)
        value = self.rig.frames[k].value
        at = self.at(k)
        lit = (cosine > 0.1) & np.isfinite(at)
        dark = (cosine < _DARK_COSINE) & np.isfinite(at)
        if dark.sum() < max(30, 0.03 * lit.sum()) or lit.sum() < 30:
            return None
        bright = float(at[lit].mean())
        if not bright > 0:
            return None
        basis = np.column_stack([np.ones(int(dark.sum())), self.hits.normals[dark]])
        fitted, *_ = np.linalg.lstsq(basis, at[dark], rcond=None)
        level = float(at[dark].mean())
        ring = value[self.ring[:, 1], self.ring[:, 0]].mean(axis=-1)
        around = float(np.nanmedian(ring)) / bright if len(ring) else float("nan")
        even = abs(fitted[0]) + 1e-12
        return Shadow(level / bright, fitted[1:] / even, around, int(dark.sum()))


def _shadow_warnings(shadows: list[Shadow | None]) -> list[str]:
    seen = [(k, s) for k, s in enumerate(shadows) if s is not None]
    bright = [(k, s) for k, s in seen if s.level > _STRAY]
    if not bright:
        return []
    k, worst = max(bright, key=lambda pair: pair[1].level)
    text = (
        f"The attached shadow is not dark: {worst.level:.1%} of the lit part under light {k} "
        f"({len(bright)} of {len(seen)} lights above {_STRAY:.0%})"
    )
    slope = np.mean([s.slope for _, s in bright], axis=0)
    if float(np.linalg.norm(slope)) > _UNEVEN:
        names = ("right", "left"), ("below", "above"), ("behind", "the camera's side")
        axis = int(np.argmax(np.abs(slope)))
        side = names[axis][0 if slope[axis] > 0 else 1]
        return [f"{text}, and brighter towards {side}: light returned by what stands there (interreflection)."]
    return [f"{text}, evenly: stray light in the lens, a dark offset, or light from all round."]


def _warnings(
    rig: PhotographedRig, check: LightCheck | None, shadows: list[Shadow | None], matte: Linearity | None
) -> tuple[str, ...]:
    """What is likely wrong with the rig, its pictures and its lights."""
    # Where the lights are elsewhere, what is taken for a shadow is none.
    misplaced = check is not None and check.misplaced
    warnings = [*rig.warnings, *(check.warnings if check is not None else ())]
    warnings += [*([] if misplaced else _shadow_warnings(shadows)), *_picture_warnings(rig)]
    said = matte.contradiction("linear once decoded") if matte is not None else ""
    if said and rig.linearity is None:
        warnings.append(said)
    return tuple(warnings)


def _picture_warnings(rig: PhotographedRig) -> list[str]:
    """What was said about single pictures, each kind once, with the sum of what was counted."""
    counted: dict[str, dict[int, int]] = {}
    remarked: dict[str, tuple[str, list[int]]] = {}
    for k, merged in rig.frames.told.items():
        for said, count in merged.counts.items():
            counted.setdefault(said, {})[k] = count
        for note in merged.remarks:
            kind = " ".join(word for word in note.split() if not any(c.isdigit() for c in word))
            remarked.setdefault(kind, (note, []))[1].append(k)
    found = []
    for said, by_light in counted.items():
        worst = max(by_light, key=lambda k: by_light[k])
        most = f" (most under light {worst}: {by_light[worst]})" if len(by_light) > 1 else ""
        found.append(f"{_lights(list(by_light))}: {sum(by_light.values())} {said}{most}")
    for note, ks in remarked.values():
        found.append(f"{_lights(ks)}: {note}" if len(ks) == 1 else f"{_lights(ks)}, for instance {ks[0]}: {note}")
    return found


def _lights(ks: list[int]) -> str:
    return f"Light {ks[0]}" if len(ks) == 1 else f"{len(ks)} lights"


def _unresolved(rig: PhotographedRig, shadows: list[Shadow | None]) -> list[str]:
    """Faults without a calibration."""
    found = []
    levels = [s.level for s in shadows if s is not None]
    told = f"; the attached shadows show {np.mean(levels):.2%}" if levels else "; no attached shadow is in view"
    calibrated = rig.corrected
    if "stray" not in calibrated:
        found.append(f"stray light: no black box{told}")
    if "dark" not in calibrated:
        found.append("dark offset: no dark frame")
    if "flat" not in calibrated:
        found.append("vignetting: no flat field")
    if "lens" not in calibrated:
        found.append("lens distortion: no calibration board")
    if "linearity" not in calibrated:
        found.append("linearity: declared, no exposure stack")
    if not np.isfinite(rig.white_sd):
        found.append("scale: no white reference, the BRDF is known up to a factor")
    if rig.camera.orthographic:
        found.append("perspective: an orthographic camera is assumed")
    if rig.noise_known == "quantisation":
        found.append("noise: none seen, samples have the error of the steps of the stored values alone")
    if rig.noise_known == "unknown":
        found.append("noise: not known, samples have no standard error")
    return found
