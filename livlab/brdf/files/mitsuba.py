"""Mitsuba's `measured` materials, `.bsdf` (Dupuy & Jakob 2018): written from a table or a function, read, evaluated.

The file tabulates over the direction to the camera (θ, and φ if anisotropic) and the half vector m, whose coordinates
run as u = √(2 θ_m/π) and v = (φ_m − φ + π)/2π over the unit square; a warp by the visible normals may lie between the
square and the table. With `jacobian` 0 the table holds f cos θ of the light; with 1 that value is to be multiplied by
ndf / (4 sigma). Mitsuba's `wi` is the direction to the camera, here wo.

Between its points Mitsuba interpolates f cos θ linearly, also across the horizon, beyond which the table holds 0.
Divided by the cosine of the direction that is asked for, what is left of that is any number. So towards the horizon
`MitsubaMaterial.known` divides by the cosine interpolated alike, which gives a mean of f at the points above, and tells
where these differ too much for a mean to say anything.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import xarray as xr

from livlab.brdf.angles import direction
from livlab.brdf.files.interface import HOLES, FileFunctions, Function, Holes
from livlab.brdf.files.tensor import Array, read_tensors, write_tensors
from livlab.brdf.files.warp import Warp, between, cell
from livlab.brdf.lookup import fill_holes, lookup
from livlab.brdf.table import Evaluate, as_table
from livlab.errors import DatasetError, InputError

FloatArray = npt.NDArray[np.float64]

LOW = float(np.deg2rad(85.0))
"""Angle of light or camera from which the cosine is interpolated as the table is."""

UNLIKE = 1.25
"""Ratio of the largest to the smallest f of a cell's points from which, beyond `LOW`, the cell is a hole."""

MOST_ABOVE = 0.9
"""Share of a cell's weight that has to lie above the horizon: the rest would be extrapolated."""

STEEPEST = float(np.deg2rad(89.0))
"""θ at which the slice of 90 degrees is evaluated: at 90 degrees itself no light arrives."""


def write_mitsuba(
    path: Path,
    brdf: xr.Dataset | Evaluate,
    *,
    wavelengths_nm: npt.ArrayLike | None = None,
    theta_count: int = 48,
    size: int = 96,
    holes: Holes = "refuse",
    description: str = "livlab",
) -> None:
    """Write an isotropic BRDF for Mitsuba's `measured` plugin, with `jacobian` 0 and no warp.

    Parameters
    ----------
    brdf : table, or function of wi and wo
        Three channels make an RGB file, for Mitsuba's `_rgb` variants; one channel is written three times.
    wavelengths_nm : (channel,) array
        Wavelengths of the channels, rising: makes a spectral file, for the `_spectral` variants.
    theta_count, size : int
        Directions to the camera from 0 to 90°, and points along each side of the square of half vectors. Between them
        Mitsuba interpolates linearly; the file takes about 4 · theta_count · size² · (channels + 1) bytes.
    holes
        Of a table: `refuse` them, `fill` them (`livlab.brdf.lookup.fill_holes`), or write `zero`.

    Raises
    ------
    InputError
        Holes that are to be refused, negative or infinite values, channels that do not fit.
    EnvironmentProblem
        The file cannot be written; an old one stays as it was.
    """
    for name, count in (("theta_count", theta_count), ("size", size)):
        if not 4 <= count <= 512:
            raise InputError.of(name, count, "must lie between 4 and 512", "Give 48 directions and 96 points.")
    evaluate = _reader(brdf, holes) if isinstance(brdf, xr.Dataset) else brdf
    theta = np.linspace(0, np.pi / 2, theta_count)
    value = np.stack([_slice(evaluate, min(angle, STEEPEST), size) for angle in theta])
    if not np.all(np.isfinite(value)) or np.any(value < 0):
        bad = ~(np.isfinite(value) & (value >= 0))
        raise InputError.of(
            "brdf",
            f"{int(bad.any(axis=-1).sum())} of {bad[..., 0].size} directions",
            "are holes, negative or infinite",
            "Fill the holes of a table with holes='fill' (--holes fill), or write them as 0 with holes='zero'; "
            "clip negative values.",
        )
    channels = value.shape[-1]
    fields: dict[str, Array] = {
        "description": np.frombuffer(description.encode() or b" ", dtype=np.uint8),
        "phi_i": np.zeros(1, dtype=np.float32),
        "theta_i": theta.astype(np.float32),
        "ndf": np.ones((2, 2), dtype=np.float32),
        "sigma": np.ones((2, 2), dtype=np.float32),
        "vndf": np.ones((1, theta_count, 2, 2), dtype=np.float32),
        # A slice without any light could not be normalised.
        "luminance": np.maximum(value.mean(axis=-1), 1e-6 * max(float(value.max()), 1e-30)).astype(np.float32)[None],
        "jacobian": np.zeros(1, dtype=np.uint8),
    }
    planes = np.moveaxis(value, -1, 1)[None].astype(np.float32)
    if wavelengths_nm is None:
        if channels not in (1, 3):
            raise InputError.of(
                "brdf", f"{channels} channels", "must be 1 or 3 without wavelengths", "Give wavelengths_nm."
            )
        fields["rgb"] = np.repeat(planes, 3 // channels, axis=2)
    else:
        wavelengths = np.atleast_1d(np.asarray(wavelengths_nm, dtype=np.float32))
        if wavelengths.shape != (channels,) or not np.all(np.diff(wavelengths) > 0):
            raise InputError.of(
                "wavelengths_nm",
                wavelengths.tolist(),
                f"must be {channels} rising wavelengths",
                "One for each channel.",
            )
        fields["spectra"], fields["wavelengths"] = planes, wavelengths
    write_tensors(path, fields)


def _reader(table: xr.Dataset, holes: Holes) -> Evaluate:
    if holes not in HOLES:
        raise InputError.of("holes", holes, "must be refuse, fill or zero", "Choose one.")
    ready = fill_holes(table) if holes == "fill" else table

    def evaluate(wi: FloatArray, wo: FloatArray) -> FloatArray:
        found = lookup(ready, wi, wo)
        return np.where(np.isfinite(found), found, 0.0) if holes == "zero" else found

    return evaluate


def _slice(evaluate: Evaluate, theta: float, size: int) -> FloatArray:
    """F cos θ_i (row φ, column θ, channel) of the half vectors of one direction to the camera."""
    u = np.linspace(0, 1, size)
    theta_m, phi_m = np.meshgrid(u**2 * (np.pi / 2), (2 * u - 1) * np.pi)
    half = direction(theta_m, phi_m)
    eye = direction(theta, 0.0)
    light = 2 * (half @ eye)[..., None] * half - eye
    # Directions a hair above the surface have a cosine of next to nothing, and models may not be defined there.
    above = (light[..., 2] > np.cos(STEEPEST)) & (half @ eye > 0)
    found = np.asarray(evaluate(light[above], np.broadcast_to(eye, light[above].shape)), dtype=np.float64)
    found = found.reshape(int(above.sum()), -1)
    value = np.zeros((size, size, found.shape[1]))
    value[above] = found * light[above][:, 2:]
    return value


@dataclass(frozen=True, eq=False)
class MitsubaMaterial:
    """A `.bsdf` file that was read: `evaluate` gives its BRDF.

    Attributes
    ----------
    fields
        The arrays of the file.
    channels
        R, G, B or the wavelengths in nm.
    name
        The file's.
    exact
        False: the file's own values lie between what it was written from, so that it is converted as a table.
    """

    fields: dict[str, Array]
    channels: list[object]
    name: str
    exact: bool = False

    @property
    def description(self) -> str:
        """What the file says of itself."""
        return bytes(np.asarray(self.fields["description"], dtype=np.uint8)).decode("utf-8", "replace")

    @property
    def source(self) -> str:
        """File and description, for a table made of it."""
        return f"Mitsuba file {self.name}: {self.description}"

    def known(self, wi: FloatArray, wo: FloatArray) -> FloatArray:
        """BRDF (n, channel) as `evaluate`, but held near the horizon, and NaN where the file cannot tell it there.

        Within `LOW` of the normal it is `evaluate`. Beyond, of files without warp and `jacobian`, the mean
        Σ w f cos θ / Σ w cos θ over the cell's points, and NaN where their f differ by more than `UNLIKE` or less than
        `MOST_ABOVE` of the weight lies above the horizon. Of other files it is NaN there.
        """
        light, eye = np.asarray(wi, dtype=np.float64), np.asarray(wo, dtype=np.float64)
        value = self.evaluate(light, eye)
        lower = np.minimum(light[:, 2], eye[:, 2])
        vndf = np.asarray(self.fields["vndf"][0], dtype=np.float64)
        if int(self.fields["jacobian"][0]) or np.ptp(vndf) > 1e-6 * float(vndf.max()):
            value[(lower < np.cos(LOW)) & (lower > 0)] = np.nan
            return value
        low = np.flatnonzero((lower < np.cos(LOW)) & (lower > 0))
        value[low] = self._held(light[low], eye[low])
        return value

    def _held(self, light: FloatArray, eye: FloatArray) -> FloatArray:
        """Mean of f over the points of the table's cell, weighted by their cosines; NaN where they are too unlike."""
        planes = np.asarray(self.fields["rgb" if "rgb" in self.fields else "spectra"][0], dtype=np.float64)
        knots = np.asarray(self.fields["theta_i"], dtype=np.float64)
        theta, phi = _elevation(eye), np.arctan2(eye[:, 1], eye[:, 0])
        half = light + eye
        half /= np.linalg.norm(half, axis=-1, keepdims=True)
        u = np.sqrt(_elevation(half) * (2 / np.pi))
        v = np.mod((np.arctan2(half[:, 1], half[:, 0]) - phi + np.pi) / (2 * np.pi), 1.0)
        _, channels, rows, columns = planes.shape
        spots = [cell(np.interp(theta, knots, np.arange(len(knots))), len(knots))]
        spots += [cell(x * (count - 1), count) for x, count in ((v, rows), (u, columns))]
        top, below, above = np.zeros((len(light), channels)), np.zeros(len(light)), np.zeros(len(light))
        least, most = np.full((len(light), channels), np.inf), np.zeros((len(light), channels))
        for corner in itertools.product((0, 1), repeat=3):
            k, row, column = (spot[side] for spot, side in zip(spots, corner, strict=True))
            share = np.prod(
                [spot[2] if side else 1 - spot[2] for spot, side in zip(spots, corner, strict=True)], axis=0
            )
            cosine = _light_cosine(np.minimum(knots[k], STEEPEST), column / (columns - 1), row / (rows - 1))
            there = np.where(cosine > np.cos(STEEPEST), cosine, 0.0)
            stored = planes[k, :, row, column]
            top += share[:, None] * np.where(there[:, None] > 0, stored, 0.0)
            below += share * there
            above += np.where(there > 0, share, 0.0)
            counts = ((there > 0) & (share > 0.0))[:, None]
            f = stored / np.maximum(there, 1e-12)[:, None]
            least, most = np.where(counts, np.minimum(least, f), least), np.where(counts, np.maximum(most, f), most)
        with np.errstate(invalid="ignore", divide="ignore"):
            value = top / below[:, None]
        unlike = (most > UNLIKE * least).any(axis=1) | (above < MOST_ABOVE)
        return np.where(unlike[:, None], np.nan, value)

    def evaluate(self, wi: FloatArray, wo: FloatArray) -> FloatArray:
        """BRDF (n, channel) in 1/sr without cosine at directions (n, 3), wi to the light; 0 below the surface."""
        light, eye = np.asarray(wi, dtype=np.float64), np.asarray(wo, dtype=np.float64)
        half = light + eye
        half = half / np.linalg.norm(half, axis=-1, keepdims=True)
        theta, phi = _elevation(eye), np.arctan2(eye[:, 1], eye[:, 0])
        theta_m, phi_m = _elevation(half), np.arctan2(half[:, 1], half[:, 0])
        u = np.sqrt(theta_m * (2 / np.pi))
        v = np.mod((phi_m - phi + np.pi) / (2 * np.pi), 1.0)
        knots = np.asarray(self.fields["theta_i"], dtype=np.float64)
        at_u, at_v = Warp(np.asarray(self.fields["vndf"][0], dtype=np.float64), knots).invert(u, v, theta)
        planes = np.asarray(self.fields["rgb" if "rgb" in self.fields else "spectra"][0], dtype=np.float64)
        value = np.stack([between(planes[:, c], knots, theta, at_u, at_v) for c in range(planes.shape[1])], axis=-1)
        if int(self.fields["jacobian"][0]):
            ndf = between(np.asarray(self.fields["ndf"], np.float64)[None], np.zeros(1), theta, u, v)
            sigma = between(
                np.asarray(self.fields["sigma"], np.float64)[None],
                np.zeros(1),
                theta,
                np.sqrt(theta * (2 / np.pi)),
                (phi + np.pi) / (2 * np.pi),
            )
            value = value * (ndf / (4 * sigma))[:, None]
        above = (light[:, 2] > 0) & (eye[:, 2] > 0)
        return np.where(above[:, None], value / np.where(above, light[:, 2], 1.0)[:, None], 0.0)


def _light_cosine(theta: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
    """Cosine of the light at points of the square of half vectors, as `write_mitsuba` places them; 0 if turned away."""
    half = direction(u**2 * (np.pi / 2), (2 * v - 1) * np.pi)
    eye = direction(theta, np.zeros_like(theta))
    along = np.einsum("ni,ni->n", half, eye)
    return np.asarray(np.where(along > 0, 2 * along * half[:, 2] - eye[:, 2], 0.0))


def read_mitsuba(path: Path) -> MitsubaMaterial:
    """Read an isotropic `.bsdf` file, RGB or spectral.

    Raises
    ------
    DatasetError
        No tensor file, fields missing or of shapes that do not fit, an anisotropic material.
    """
    fields = read_tensors(path)
    table = "rgb" if "rgb" in fields else "spectra"
    dims = {"phi_i": 1, "theta_i": 1, "ndf": 2, "sigma": 2, "vndf": 4, "luminance": 4, table: 5, "jacobian": 1}
    dims |= {"wavelengths": 1} if table == "spectra" else {}
    wrong = [name for name, ndim in dims.items() if name not in fields or fields[name].ndim != ndim]
    if "description" not in fields or wrong:
        raise DatasetError.of(
            path.name,
            sorted(fields),
            f"lacks {', '.join(wrong) or 'description'}",
            "Give a measured material of Mitsuba.",
        )
    if fields["phi_i"].size > 2:
        raise DatasetError.of(path.name, "anisotropic", "only isotropic materials are read", "Render it with Mitsuba.")
    knots = fields["theta_i"].size
    channels: Sequence[object] = ["R", "G", "B"] if table == "rgb" else fields["wavelengths"].tolist()
    if fields["vndf"].shape[1] != knots or fields[table].shape[1:3] != (knots, len(channels)) or knots < 2:
        raise DatasetError.of(
            path.name, fields[table].shape, f"does not fit {knots} angles, {len(channels)} channels", "Fetch it again."
        )
    theta = np.asarray(fields["theta_i"], dtype=np.float64)
    planes = [fields["vndf"][0], fields[table][0], fields["ndf"], fields["sigma"]] if fields["vndf"].shape[0] else []
    sound = (
        np.all(np.diff(theta) > 0)
        and planes
        and min(side for plane in planes for side in plane.shape[-2:]) >= 2
        and all(np.isfinite(plane).all() for plane in planes)
        and fields["jacobian"].size > 0
    )
    if not sound or not np.all(np.asarray(fields["vndf"][0], dtype=np.float64).sum(axis=(1, 2)) > 0):
        raise DatasetError.of(
            path.name, "its tables", "must be finite, at least 2 x 2, over rising angles", "Fetch or write it again."
        )
    return MitsubaMaterial(fields, list(channels), path.name)


def _elevation(w: FloatArray) -> FloatArray:
    return np.arctan2(np.hypot(w[:, 0], w[:, 1]), w[:, 2])


def _write(path: Path, data: xr.Dataset, holes: Holes) -> None:
    write_mitsuba(path, as_table(data), holes=holes)


def _write_function(path: Path, function: Function) -> None:
    write_mitsuba(path, function.evaluate, description=f"livlab, {function.name}")


FILE = FileFunctions(read_mitsuba, _write, _write_function)
