"""From stored values to linear ones: what was declared, and what the pictures themselves say about it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from livlab.acquire.photographs.outline import FloatArray
from livlab.errors import InputError

Verdict = Literal["linear", "not linear", "undecided"]

_LOW, _HIGH = 0.04, 0.92
"""Share of full scale between which stored values test linearity: above black offsets, below clipping."""

_STACK_TOLERANCE = 0.03

_LAMBERT_TOLERANCE = 0.2
_ENCODED = 1.35
_DECODED_TWICE = (0.6, 0.05)
_LAMBERT_MISFIT = 0.1
"""What tells encodings from materials. Off the highlight, Lambert, Oren-Nayar (sigma to 0.9) and plastics (alpha .05 to
.4, kd .05 to .4) that a cosine fits to 10 % come out at exponents of .75 to 1.2 if they are linear, at 1.4 and more if
they are sRGB, gamma 1.8 or 2.2 (tests/reference/test_linearity_materials.py). Broad gloss alone lowers the exponent, so
below 1 more is asked for: values decoded twice, which come out at .45."""

_EXPONENTS = (0.3, 4.0)


@dataclass(frozen=True, eq=False)
class CameraResponse:
    """How stored values (0 to 1) stand for linear ones, as a table over equally spaced stored values.

    Attributes
    ----------
    name
        What it is: linear, srgb, gamma 2.2, table, debevec.
    table
        (n, 1) or (n, channels) linear values at stored values 0 ... 1, rising, 1 at 1.
    """

    name: str
    table: FloatArray = field(default_factory=lambda: np.array([[0.0], [1.0]]))

    def __post_init__(self) -> None:
        table = np.asarray(self.table, dtype=np.float64)
        table = table[:, None] if table.ndim == 1 else table
        if len(table) < 2 or not np.all(np.isfinite(table)) or np.any(np.diff(table, axis=0) < 0):
            raise InputError.of(
                "response.table", table.shape, "must hold two finite values at least and never fall", "Mend the table."
            )
        if not np.all(table[-1] > table[0]):
            raise InputError.of("response.table", table[-1].tolist(), "must rise", "Mend the table.")
        object.__setattr__(self, "table", table)

    @property
    def linear(self) -> bool:
        """Whether nothing needs to be decoded."""
        return len(self.table) == 2

    def decode(self, stored: NDArray[np.floating]) -> NDArray[np.floating]:
        """Linear values of stored ones (..., channels); past the table's ends it goes on straight."""
        if self.linear:
            low, high = self.table
            return stored if low[0] == 0 and high[0] == 1 else np.asarray(low + stored * (high - low))
        return self._through(stored, self.table)

    def slope(self, stored: NDArray[np.floating]) -> NDArray[np.floating]:
        """Derivative of linear by stored values, by which noise grows."""
        if self.linear:
            return np.broadcast_to((self.table[1] - self.table[0]).astype(stored.dtype), stored.shape)
        n = len(self.table)
        return self._through(stored, np.gradient(self.table, 1 / (n - 1), axis=0))

    def _through(self, stored: NDArray[np.floating], table: FloatArray) -> NDArray[np.floating]:
        x = np.linspace(0, 1, len(table))
        out = np.empty_like(stored)
        for c in range(stored.shape[-1]):
            column = table[:, min(c, table.shape[1] - 1)]
            out[..., c] = np.interp(stored[..., c], x, column)
        return out


def response(kind: str, *, gamma: float | None = None, table: ArrayLike | None = None) -> CameraResponse:
    """A declared response: "linear", "srgb" (IEC 61966-2-1), "gamma" (linear = stored^gamma) or "table".

    >>> float(response("srgb").decode(np.array([[0.5]]))[0, 0])  # doctest: +ELLIPSIS
    0.2140...

    Raises
    ------
    InputError
        An unknown kind, a gamma that is missing or not > 0, a table that falls.
    """
    x = np.linspace(0, 1, 4096)
    if kind == "linear":
        return CameraResponse("linear")
    if kind == "srgb":
        return CameraResponse("srgb", np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4))
    if kind == "gamma":
        if gamma is None or not 0.1 <= gamma <= 10:
            raise InputError.of("response.gamma", gamma, "must lie between 0.1 and 10", "Give linear = stored^gamma.")
        return CameraResponse(f"gamma {gamma:g}", x**gamma)
    if kind == "table" and table is not None:
        values = np.asarray(table, dtype=np.float64)
        return CameraResponse("table", values / values[-1])
    raise InputError.of("response.kind", kind, "must be linear, srgb, gamma, table or debevec", "Declare one of these.")


def debevec(frames: Sequence[NDArray[np.uint8]], exposures: Sequence[float]) -> CameraResponse:
    """Response from an exposure stack (Debevec & Malik 1997, by OpenCV), as a table of 256 values a channel.

    Parameters
    ----------
    frames
        (rows, columns, channels) 8-bit pictures of one still scene; two at least.
    exposures
        Relative exposures.

    Raises
    ------
    InputError
        Fewer than two pictures, equal exposures, shapes or types that differ.
    """
    import cv2

    _check_stack(frames, exposures)
    if any(frame.dtype != np.uint8 for frame in frames):
        raise InputError.of("frames", frames[0].dtype, "must be 8-bit pictures", "Scale them to 8 bit first.")
    three = [np.ascontiguousarray(np.broadcast_to(f, (*f.shape[:2], 3)) if f.shape[2] == 1 else f) for f in frames]
    found = cv2.createCalibrateDebevec(samples=200, lambda_=20.0).process(
        three, times=np.asarray(exposures, dtype=np.float32)
    )
    table = np.asarray(found, dtype=np.float64).reshape(256, 3)[:, : frames[0].shape[2]]
    # The ends, with weight 0, are extrapolated by it and may turn back: they are held monotone.
    table = np.maximum.accumulate(np.where(np.isfinite(table), table, 0.0), axis=0)
    return CameraResponse("debevec", (table - table[0]) / (table[-1] - table[0]))


@dataclass(frozen=True)
class Linearity:
    """What pictures say about their linearity.

    Attributes
    ----------
    verdict
        Of the values as they were decoded.
    gamma
        Exponent that would make them linear (1 where they are); NaN where the verdict is undecided.
    standard_error
        Of gamma: scatter, and what the method cannot tell from it; infinite where the verdict is undecided.
    route
        "exposure stack" or "sphere off its highlight".
    residual, residual_best
        Relative residual at 1 and at its best exponent (sphere), or of the ratios (stack).
    residual_srgb
        Relative residual if the values were sRGB (sphere); NaN of a stack.
    over_noise
        Residual over what the pixels' noise lets expect (sphere), or the unlikeness of dark and bright values over its
        standard error (stack); NaN where the noise is not known.
    notes
        What a reader should know.
    """

    verdict: Verdict
    gamma: float
    standard_error: float
    route: str
    residual: float
    residual_best: float
    residual_srgb: float = float("nan")
    notes: tuple[str, ...] = ()
    over_noise: float = float("nan")

    def told(self) -> str:
        """The verdict in words: an exponent only where one was found, else why there is none."""
        if self.verdict == "undecided":
            return f"undecided: {' '.join(self.notes)}".rstrip()
        text = f"{self.verdict}: exponent {self.gamma:.3f} +- {self.standard_error:.3f}"
        if math.isfinite(self.residual_srgb):
            text += f"; residual from a cosine {self.residual:.1%}, as sRGB {self.residual_srgb:.1%}"
        if math.isfinite(self.over_noise):
            what = "one exponent misses dark against bright values by" if self.route == "exposure stack" else "that is"
            text += f"; {what} {self.over_noise:.2g} x the noise"
        return text

    def contradiction(self, declared: str) -> str | None:
        """The warning to give where the data contradict what was declared; None where they do not."""
        if self.verdict != "not linear":
            return None
        text = (
            f"Declared {declared}, but the {self.route} shows values that go as radiance^{1 / self.gamma:.2f} once "
            f"decoded (gamma {self.gamma:.2f} +- {self.standard_error:.2f}): the response is not what was declared."
        )
        if self.residual_srgb < 0.7 * self.residual:
            text += (
                f" As sRGB it misses a cosine by {self.residual_srgb:.0%} only, as declared by {self.residual:.0%}: "
                'say kind = "srgb" under [response].'
            )
        return text


def from_exposures(
    stack: Sequence[NDArray[np.floating]], exposures: Sequence[float], stored: Sequence[NDArray[np.floating]]
) -> Linearity:
    """Linearity from an exposure stack: log ratios of decoded values against log ratios of exposures.

    Values that go as exposure^(1/g) give log-log slopes of 1/g; the slope is the median over pixels and pairs.

    Parameters
    ----------
    stack
        (rows, columns, channels) decoded values of one still scene.
    exposures
        Relative exposures, unlike.
    stored
        The same before decoding, 0 to 1, to tell which are clipped or black.

    Raises
    ------
    InputError
        Fewer than two pictures, shapes that differ, equal exposures.
    """
    _check_stack(stack, exposures)
    order = np.argsort(exposures)
    slopes, halves, errors = [], [], []
    for i, j in itertools.pairwise(order):
        ratio = float(np.log(exposures[j] / exposures[i]))
        if ratio < 0.05:
            continue
        a, b = stack[i], stack[j]
        use = (stored[i] > _LOW) & (stored[j] < _HIGH) & (a > 0) & (b > 0)
        if use.sum() < 50:
            continue
        slope = np.log(b[use] / a[use]) / ratio
        slopes.append((float(np.median(slope)), int(use.sum()), ratio))
        level = stored[i][use]
        dark = level < np.median(level)
        halves.append((float(np.median(slope[dark])), float(np.median(slope[~dark]))))
        errors.append(math.hypot(*(_median_error(slope[part]) for part in (dark, ~dark))))
    if not slopes:
        note = "No pair of exposures has fifty pixels that are neither black nor clipped in both."
        return Linearity(
            "undecided", float("nan"), float("inf"), "exposure stack", float("nan"), float("nan"), notes=(note,)
        )
    s = np.array([x[0] for x in slopes])
    weight = np.array([x[2] for x in slopes])  # a long step knows the slope best
    mean = float(np.average(s, weights=weight))
    scatter = float(np.sqrt(np.average((s - mean) ** 2, weights=weight) / max(len(s) - 1, 1)))
    error = float(np.hypot(scatter, 0.005))
    notes = []
    low, high = np.average(np.array(halves), axis=0, weights=weight)
    if abs(mean - 1) > _STACK_TOLERANCE and abs(low - high) > 0.5 * abs(mean - 1) + 0.01:
        notes.append(
            f"Dark values follow exposure^{low:.2f}, bright ones exposure^{high:.2f}: a black offset, stray light or "
            "sRGB's straight foot rather than one gamma."
        )
    unlike = abs(low - high) / max(float(np.hypot.reduce(weight * errors) / weight.sum()), 1e-6)
    if not notes and unlike > 5 and abs(low - high) > _STACK_TOLERANCE:
        notes.append(
            f"One exponent does not fit: dark values follow exposure^{low:.2f}, bright ones exposure^{high:.2f}, "
            f"{unlike:.2g} x the noise apart."
        )
    linear = abs(mean - 1) <= _STACK_TOLERANCE + 2 * error
    verdict: Verdict = "linear" if linear else "not linear"
    return Linearity(
        verdict,
        1 / mean,
        error / mean**2,
        "exposure stack",
        abs(mean - 1),
        scatter,
        notes=tuple(notes),
        over_noise=unlike,
    )


def _median_error(x: FloatArray) -> float:
    """Standard error of a median, from the scatter about it; that of 16 x 16 neighbours counts once for each 16."""
    if len(x) < 2:
        return math.inf
    return 1.2533 * 1.4826 * float(np.median(np.abs(x - np.median(x)))) / math.sqrt(max(len(x) / 16, 1.0))


def from_matte_sphere(
    values: FloatArray,
    cosines: FloatArray,
    *,
    least_cosine: float = 0.26,
    beside: bool = False,
    variances: FloatArray | None = None,
) -> Linearity:
    """Linearity from a sphere under known lights: the exponent at which values best follow the cosine.

    A cosine is no law of nature: roughness, and gloss beyond the highlight, move the exponent by some tenths. So the
    verdict is "linear" where it lies within 0.2 of 1, and "not linear" only where a cosine fits well at an exponent
    that no known material gives linear values. Otherwise it is "undecided", and no exponent is told.

    Parameters
    ----------
    values : (lights, pixels) array
        Decoded values; NaN where not usable, as in the highlight.
    cosines : (lights, pixels) array
        n.l, times the relative irradiance of each light.
    least_cosine : float
        Pixels below are left out; 75°.
    beside : bool
        Whether all lights stand beside the camera, where a rough surface looks flat as an encoded one does: then
        nothing but "linear" can be found.
    variances : (lights, pixels) array, optional
        Of the values, where the noise is known.

    Raises
    ------
    InputError
        Shapes that differ, or fewer than a hundred usable values.
    """
    from scipy import optimize

    if values.shape != cosines.shape:
        raise InputError.of("values", values.shape, f"must have the shape of cosines {cosines.shape}", "Mend it.")
    use = np.isfinite(values) & (cosines >= least_cosine) & (values > 0)
    if use.sum() < 100:
        raise InputError.of("values", int(use.sum()), "needs a hundred usable values", "See that the sphere is lit.")
    v, c = values[use] / np.max(values[use]), cosines[use]

    def residual(x: FloatArray) -> float:
        a = (x @ c) / (c @ c)
        return float(np.sqrt(np.mean((x - a * c) ** 2)) / np.mean(x))

    best = optimize.minimize_scalar(
        lambda g: residual(v**g), bounds=_EXPONENTS, method="bounded", options={"xatol": 1e-3}
    )
    gamma, least = float(best.x), float(best.fun)
    at_srgb = residual(np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4))
    verdict, note = _judged(gamma, least, beside=beside)
    found = verdict != "undecided"
    noise = math.nan
    if variances is not None and np.isfinite(variances[use]).all():
        noise = math.sqrt(float(np.mean(variances[use]))) / float(np.mean(values[use]))
    return Linearity(
        verdict=verdict,
        gamma=gamma if found else math.nan,
        standard_error=_LAMBERT_TOLERANCE / 2 if found else math.inf,
        route="sphere off its highlight",
        residual=residual(v),
        residual_best=least,
        residual_srgb=at_srgb,
        notes=(note,) if note else (),
        over_noise=residual(v) / noise if noise > 0 else math.nan,
    )


def _judged(gamma: float, least: float, *, beside: bool) -> tuple[Verdict, str]:
    """The verdict on an exponent and the residual there, and why it is none."""
    most = _LAMBERT_MISFIT / 2 if beside else _LAMBERT_MISFIT  # along one axis more things look like a cosine
    if min(gamma - _EXPONENTS[0], _EXPONENTS[1] - gamma) < 0.02 or least > most:
        low, high = _EXPONENTS
        return "undecided", (
            f"the sphere is not matte: off its highlight it misses a cosine by {least:.0%} or more at any exponent "
            f"from {low:g} to {high:g}. An exposure stack would tell."
        )
    if abs(gamma - 1) <= _LAMBERT_TOLERANCE:
        return "linear", ""
    if beside:
        return "undecided", (
            "the lights stand beside the camera, where a rough surface looks flat as an encoded one does. "
            "A light from the side, or an exposure stack, would tell."
        )
    if gamma >= _ENCODED or (gamma <= _DECODED_TWICE[0] and least <= _DECODED_TWICE[1]):
        return "not linear", ""
    return "undecided", (
        f"what is left from a cosine ({least:.0%} off the highlight) may be the material's or the camera's. "
        "An exposure stack would tell."
    )


def _check_stack(frames: Sequence[NDArray[np.generic]], exposures: Sequence[float]) -> None:
    if len(frames) < 2 or len(frames) != len(exposures):
        raise InputError.of(
            "frames",
            f"{len(frames)} pictures, {len(exposures)} exposures",
            "must be two at least, one each",
            "Add one.",
        )
    if len({frame.shape for frame in frames}) > 1:
        raise InputError.of("frames", sorted({f.shape for f in frames}), "must have one size", "Give uncropped ones.")
    e = np.asarray(exposures, dtype=float)
    if not np.all(np.isfinite(e) & (e > 0)) or np.ptp(e) <= 0.05 * e.max():
        raise InputError.of(
            "exposures", list(exposures), "must be > 0 and unlike", "Give the exposure of each picture."
        )
