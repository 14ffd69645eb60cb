"""Adding–doubling in plane layers of unequal index: the deterministic reference for flat stacks.

Solves the azimuth-averaged scalar transfer equation with Fresnel surfaces (unpolarised at each interface)
on nodes that all layers share (`quadrature`), with phase functions averaged over the nodes' solid angles,
thin layers doubled and added (`doubling`), at rising node counts until the totals stand still.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr

from livlab.errors import InputError
from livlab.model.tissue.stack import REDIRECT_MEAN, OpticalStack, Phase, PlaneLayer
from livlab.model.transport.doubling import (
    Below,
    add_interface,
    add_layer,
    clear_below,
    homogeneous_layer,
    redistribution,
)
from livlab.model.transport.fresnel import fresnel, incoherent_stack
from livlab.model.transport.quadrature import Grid, gauss_legendre, interval_cosines, interval_place, lagrange
from livlab.units import FloatArray

LEVELS = (8, 12, 16, 24, 32, 48, 64, 96)
"""Nodes per interval that are tried in turn."""

HIGHEST_ORDER = 2048
"""Default limit of the Legendre order; a longer tail of moments is taken as a forward peak (delta-M)."""

ANGLES = 24
"""Exit directions per panel in the result."""

_ORDER_OF_CONVERGENCE = 4
"""Least order seen: the µ ln µ of the radiance at grazing directions, integrated in the mapped variable."""


@dataclass(frozen=True)
class _Medium:
    """One layer at one wavelength: mm, 1/mm, and the moments of its phase function."""

    n: float
    thickness: float
    absorption: float
    scattering: float
    moments: FloatArray


@dataclass(frozen=True)
class _Level:
    """What one node count gives: totals, absorbed per layer, and the exit radiance at the nodes."""

    grid: Grid
    reflected: float
    transmitted: float
    reflected_diffuse: float
    transmitted_diffuse: float
    absorbed: FloatArray
    absorbed_diffuse: FloatArray
    radiance_up: FloatArray
    radiance_down: FloatArray

    def distance(self, other: _Level) -> float:
        """Largest difference of the totals."""
        return max(
            abs(self.reflected - other.reflected),
            abs(self.transmitted - other.transmitted),
            abs(self.reflected_diffuse - other.reflected_diffuse),
            abs(self.transmitted_diffuse - other.transmitted_diffuse),
        )


def adding_doubling(
    stack: OpticalStack,
    *,
    mu0: float = 1.0,
    nodes: int | None = None,
    tolerance: float = 1e-6,
    order: int = HIGHEST_ORDER,
) -> xr.Dataset:
    """Reflectance, transmittance and absorption of a stack, total and by angle, to a stated error.

    µ ∂L/∂z = −(µ_a + µ_s) L + µ_s ∫ p L dΩ' in each layer, R + (1 − R) at each interface (van de Hulst
    1980, ch. 4; Prahl, van Gemert & Welch 1993 for the fluxes and surfaces).

    Parameters
    ----------
    stack
        The layers. An element's `absorb_below_mm` depends on a path's length, which transfer theory does
        not know: its albedo is multiplied by the chance e^(−µ_t D) that a free path in the layer is
        longer, as if each meeting were independent (said in `attrs["notes"]`).
    mu0
        Cosine of incidence in the medium above, in (0, 1]; 1 is a true collimated normal beam.
    nodes
        Nodes per interval between critical sines, ≥ 4. By default they rise until `tolerance` is met.
    tolerance
        Wanted absolute error of the totals, > 0.
    order
        Highest Legendre moment of the phase functions that is kept, ≥ 1.

    Returns
    -------
    xr.Dataset
        With dimension wavelength (nm), all as a share of the incident flux: `specular` (first surface),
        `reflectance` (without it), `unscattered_reflectance` (its part that only inner interfaces sent
        back), `transmittance` (all), `unscattered_transmittance`, `absorbed` (wavelength, layer),
        `residual` (1 less all of these), `reflectance_diffuse_incidence` (with the specular part),
        `transmittance_diffuse_incidence`, `absorbed_diffuse_incidence`; `reflectance_angular` and
        `transmittance_angular` in 1/sr: scattered flux per solid angle of the outside, L·µ_o averaged
        over azimuth, at cosines mu_o (above) and mu_t (below), whose quadrature weights are
        `solid_angle` and `solid_angle_below`; `error_estimate`, `nodes`, `converged`.

    Raises
    ------
    InputError
        A parameter out of its bounds.

    Notes
    -----
    The error estimate is the difference of the last two node counts N' < N times q/(1 − q), q = (N'/N)⁴:
    fourth order is the slowest convergence that occurs, so it is an upper estimate. A half-space without
    absorption returns everything, by the limit.

    Examples
    --------
    >>> from livlab.model.tissue.stack import plain_stack
    >>> from livlab.model.tissue.phase import HenyeyGreenstein
    >>> slab = plain_stack([(1.0, 1.0, 9.0, 0.2, HenyeyGreenstein(0.75))])
    >>> result = adding_doubling(slab)
    >>> round(float(result.reflectance[0]), 5), round(float(result.transmittance[0]), 5)
    (0.09739, 0.66096)
    """
    if not 0 < mu0 <= 1:
        raise InputError.of("mu0", mu0, "must be in (0, 1]", "Give the cosine of incidence above the stack.")
    if nodes is not None and (nodes != int(nodes) or nodes < 4):
        raise InputError.of("nodes", nodes, "must be an integer of at least 4", "Leave it out to let livlab choose.")
    if not (math.isfinite(tolerance) and tolerance > 0):
        raise InputError.of("tolerance", tolerance, "must be positive", "Give an absolute error, such as 1e-6.")
    if order != int(order) or order < 1:
        raise InputError.of("order", order, "must be an integer of at least 1", "Leave it out.")
    moments = _Moments(int(order), min(1e-8, 1e-3 * tolerance))
    solved = [_solve(stack, k, mu0, nodes, tolerance, moments) for k in range(len(stack.wavelength_nm))]
    return _dataset(stack, mu0, tolerance, solved, _notes(stack, moments))


def exit_flux(result: xr.Dataset, mu_o: FloatArray) -> xr.DataArray:
    """Scattered flux per solid angle in 1/sr at any cosines above the stack, interpolated as it was solved.

    Parameters
    ----------
    result
        From `adding_doubling`.
    mu_o
        Cosines of exit in [0, 1].

    Returns
    -------
    xr.DataArray
        (wavelength, mu_o).

    Raises
    ------
    InputError
        A cosine outside [0, 1].
    """
    mu_o = np.atleast_1d(np.asarray(mu_o, dtype=np.float64))
    if not ((mu_o >= 0) & (mu_o <= 1)).all():
        raise InputError.of("mu_o", mu_o, "must be in [0, 1]", "Give cosines of exit directions.")
    breaks = np.atleast_1d(result.attrs["angular_breaks"])
    top = float(breaks[-1])
    sine = top * np.sqrt((1 - mu_o) * (1 + mu_o))
    radiance = (result.reflectance_angular / result.mu_o).to_numpy()
    values = np.empty((radiance.shape[0], mu_o.size))
    low = 0.0
    for k, high in enumerate(float(b) for b in breaks):
        inside = (sine >= low) & (sine <= high)
        basis = lagrange(ANGLES, interval_place(low, high, sine[inside]))
        values[:, inside] = radiance[:, k * ANGLES : (k + 1) * ANGLES] @ basis.T
        low = high
    return xr.DataArray(
        values * mu_o,
        dims=("wavelength", "mu_o"),
        coords={"wavelength": result.wavelength, "mu_o": mu_o},
        attrs={"units": "1/sr"},
    )


def cone_fraction(result: xr.Dataset, mu_min: float) -> xr.DataArray:
    """Share of the incident flux that leaves scattered within a cone about the normal: 2π ∫ L µ dµ, µ ≥ mu_min.

    A collinear sensor with acceptance half-angle α sees mu_min = cos α. Surface reflection, and what inner
    interfaces return unscattered, are not in it.

    Parameters
    ----------
    result
        From `adding_doubling`.
    mu_min
        Least cosine of exit, in [0, 1]; 0 takes the hemisphere.

    Returns
    -------
    xr.DataArray
        (wavelength,).

    Raises
    ------
    InputError
        mu_min outside [0, 1].
    """
    if not 0 <= mu_min <= 1:
        raise InputError.of("mu_min", mu_min, "must be in [0, 1]", "Give the cosine of the cone's half-angle.")
    breaks = [float(b) for b in np.atleast_1d(result.attrs["angular_breaks"])]
    top = breaks[-1]
    edge = top * math.sqrt((1 - mu_min) * (1 + mu_min))
    t, w = gauss_legendre(2 * ANGLES)
    total: xr.DataArray = xr.zeros_like(result.reflectance)
    low = 0.0
    for high in breaks:
        if edge <= low:
            break
        # In the panel's own variable, where the radiance is a polynomial.
        end = float(interval_place(low, high, np.array(min(edge, high))))
        place = end * t
        mu = interval_cosines(top, low, high, place)
        span = (high - low) * (high + low) * 0.25 * math.pi * np.sin(math.pi * place) / (top * top * mu)
        weight = xr.DataArray(2 * math.pi * end * w * span, dims="mu_o", coords={"mu_o": mu})
        total = total + (exit_flux(result, mu) * weight).sum("mu_o")
        low = high
    total.attrs = {"units": "1", "long_name": f"scattered flux within cos >= {mu_min:g}"}
    return total


class _Moments:
    """Legendre moments of phase functions, each asked once, cut where they have died out."""

    def __init__(self, highest: int, negligible: float) -> None:
        self.highest = highest
        self.negligible = negligible
        self.worst_peak = 0.0
        self._known: dict[int, tuple[Phase, FloatArray]] = {}

    def of(self, phase: Phase) -> FloatArray:
        """χ_0 … χ_L."""
        known = self._known.get(id(phase))
        if known is None:
            known = (phase, self._find(phase))
            self._known[id(phase)] = known
        return known[1]

    def _find(self, phase: Phase) -> FloatArray:
        ask = min(32, self.highest)
        while True:
            chi = np.asarray(phase.legendre(ask), dtype=np.float64)
            last = int(np.flatnonzero(np.abs(chi) > self.negligible)[-1])
            if last <= 0.75 * ask or ask == self.highest:
                return chi[: last + 1]
            ask = min(2 * ask, self.highest)

    def layer(self, parts: list[tuple[float, Phase]]) -> tuple[float, FloatArray]:
        """Scattering that is left and moments of a mixture; a peak beyond the highest order counts as unscattered."""
        scattering = math.fsum(w for w, _ in parts)
        chis = [(w / scattering, self.of(p)) for w, p in parts]
        chi = np.zeros(max(len(c) for _, c in chis))
        for weight, c in chis:
            chi[: len(c)] += weight * c
        chi[0] = 1.0
        if len(chi) > self.highest and chi[-1] > 0:
            peak = float(chi[-1])
            self.worst_peak = max(self.worst_peak, peak)
            return scattering * (1 - peak), (chi[:-1] - peak) / (1 - peak)
        return scattering, chi


def _medium(layer: PlaneLayer, index: int, n: float, moments: _Moments) -> _Medium:
    """A layer's coefficients at one wavelength, the short free paths' absorption included."""
    extinction = math.fsum(float(i.rate[index]) for i in layer.interactions)
    absorption, parts = [], []
    for i in layer.interactions:
        rate = float(i.rate[index])
        long_path = math.exp(-extinction * i.absorb_below_mm)
        albedo = float(i.albedo[index]) * REDIRECT_MEAN[i.redirect]
        absorption.append(rate * (1.0 - albedo))
        absorption.append(rate * albedo * -math.expm1(-extinction * i.absorb_below_mm))
        if rate * albedo * long_path > 0:
            parts.append((rate * albedo * long_path, i.phases[index]))
    scattering, chi = moments.layer(parts) if parts else (0.0, np.ones(1))
    return _Medium(n, layer.thickness_mm, math.fsum(absorption), scattering, chi)


@dataclass(frozen=True)
class _Solved:
    """One wavelength's answer."""

    level: _Level
    error: float
    nodes: int
    specular: float
    unscattered_up: float
    unscattered_down: float


def _solve(
    stack: OpticalStack, index: int, mu0: float, nodes: int | None, tolerance: float, moments: _Moments
) -> _Solved:
    n_above, n_below = float(stack.n_above[index]), float(stack.n_below[index])
    own = [float(layer.n[index]) for layer in stack.layers]
    if math.isinf(stack.layers[-1].thickness_mm):
        n_below = own[-1]
    beam = n_above * math.sqrt((1 - mu0) * (1 + mu0))
    indices = [n_above, *own, n_below]
    first = Grid.of(indices, 4, beam)
    media = [_medium(layer, index, first.snap(n), moments) for layer, n in zip(stack.layers, own, strict=True)]
    counts = LEVELS if nodes is None else (max(4, 2 * int(nodes) // 3), int(nodes))
    previous, error, level, used = None, math.inf, None, 0
    for used in counts:
        level = _level(Grid.of(indices, used, beam), first.snap(n_above), media, first.snap(n_below))
        if previous is not None:
            ratio = (previous[0] / used) ** _ORDER_OF_CONVERGENCE
            # With 4 nodes asked both counts may coincide: then nothing is known of the error.
            error = level.distance(previous[1]) * ratio / (1 - ratio) if ratio < 1 else math.nan
            if nodes is None and error <= tolerance:
                break
        previous = (used, level)
    assert level is not None
    depths = [0.0 if m.absorption + m.scattering == 0 else (m.absorption + m.scattering) * m.thickness for m in media]
    up, down = incoherent_stack([first.snap(n) for n in indices], mu0, depths)
    specular = float(fresnel(first.snap(n_above), media[0].n, mu0))
    return _Solved(level, error, used, specular, max(up - specular, 0.0), down)


def _level(grid: Grid, n_above: float, media: list[_Medium], n_below: float) -> _Level:
    """Solve at one node count, from the bottom up."""
    scatter: dict[tuple[float, bytes], tuple[FloatArray, FloatArray]] = {}
    below = clear_below(len(grid.active(n_below)))
    under = n_below
    for m in reversed(media):
        below = add_interface(grid, m.n, under, below)
        key = (m.n, m.moments.tobytes())
        if key not in scatter:
            scatter[key] = redistribution(grid, m.n, m.moments)
        layer = homogeneous_layer(grid.cosines(m.n), *scatter[key], m.absorption, m.scattering, m.thickness)
        below = add_layer(layer, below)
        under = m.n
    below = add_interface(grid, n_above, under, below)
    return _totals(grid, n_above, n_below, below)


def _totals(grid: Grid, n_above: float, n_below: float, whole: Below) -> _Level:
    flux = grid.flux()
    upper, lower = grid.active(n_above), grid.active(n_below)
    diffuse = flux[upper] / flux[upper].sum()
    up, down = flux[upper] > 0, flux[lower] > 0
    # Unit flux from a node is radiance n² / (2π s ds): its solid angle times its cosine.
    return _Level(
        grid,
        float(whole.reflectance[:, 0].sum()),
        float(whole.transmittance[:, 0].sum()),
        float(whole.reflectance.sum(axis=0) @ diffuse),
        float(whole.transmittance.sum(axis=0) @ diffuse),
        whole.absorbed[:, 0],
        whole.absorbed @ diffuse,
        whole.reflectance[up, 0] * n_above**2 / (2 * math.pi * flux[upper][up]),
        whole.transmittance[down, 0] * n_below**2 / (2 * math.pi * flux[lower][down]),
    )


def _radiance_at(grid: Grid, radiance: FloatArray, sine: FloatArray) -> FloatArray:
    """Interpolate node values of an outer medium to other sines."""
    values = np.zeros_like(sine)
    low, start = 0.0, 0
    for high, count in zip(grid.breaks, grid.counts, strict=True):
        if start >= len(radiance):
            break
        inside = (sine >= low) & (sine <= high)
        values[inside] = lagrange(count, interval_place(low, high, sine[inside])) @ radiance[start : start + count]
        low, start = high, start + count
    return values


def _angular_grid(stack: OpticalStack, outside: FloatArray) -> Grid:
    """Exit directions common to all wavelengths, broken at the critical angles of rarer layers."""
    top = float(outside.mean())
    rarer = [float(x.n.mean()) for x in stack.layers if float(x.n.mean()) < top]
    grid = Grid.of([*rarer, top], ANGLES, 0.0)
    return Grid(grid.breaks, (ANGLES,) * len(grid.breaks), 0.0)


def _notes(stack: OpticalStack, moments: _Moments) -> list[str]:
    notes = list(stack.notes)
    if any(i.absorb_below_mm > 0 for x in stack.layers for i in x.interactions):
        notes.append(
            "absorption of short free paths is taken in the mean: albedo times exp(-extinction * absorb_below_mm)"
        )
    if moments.worst_peak > 0:
        notes.append(
            f"phase function longer than {moments.highest} moments: {moments.worst_peak:.2g} of the scattering "
            "counts as unscattered (delta-M)"
        )
    return notes


def _dataset(stack: OpticalStack, mu0: float, tolerance: float, solved: list[_Solved], notes: list[str]) -> xr.Dataset:
    above, under = _angular_grid(stack, stack.n_above), _angular_grid(stack, stack.n_below)
    angular, coords, weights = {}, {}, {}
    for name, grid, dim in (("reflectance", above, "mu_o"), ("transmittance", under, "mu_t")):
        top = grid.breaks[-1]
        mu = grid.cosines(top)[1:]
        share = np.sqrt((1 - mu) * (1 + mu))
        rows = []
        for k, s in enumerate(solved):
            n = float((stack.n_above if name == "reflectance" else stack.n_below)[k])
            radiance = s.level.radiance_up if name == "reflectance" else s.level.radiance_down
            rows.append(_radiance_at(s.level.grid, radiance, s.level.grid.snap(n) * share) * mu)
        angular[f"{name}_angular"] = (("wavelength", dim), np.array(rows), {"units": "1/sr"})
        coords[dim] = (dim, mu, {"units": "1"})
        weights[dim] = (dim, 2 * math.pi * grid.flux()[1:] / (top * top * mu), {"units": "sr"})

    def column(values: list[float]) -> tuple[str, FloatArray, dict[str, str]]:
        return ("wavelength", np.array(values), {"units": "1"})

    reflectance = [s.level.reflected - s.specular for s in solved]
    absorbed = np.array([s.level.absorbed for s in solved])
    balance = [
        1.0 - s.specular - r - s.level.transmitted - float(s.level.absorbed.sum())
        for s, r in zip(solved, reflectance, strict=True)
    ]
    layer_dims = ("wavelength", "layer")
    return xr.Dataset(
        {
            "reflectance": column(reflectance),
            "specular": column([s.specular for s in solved]),
            "unscattered_reflectance": column([s.unscattered_up for s in solved]),
            "transmittance": column([s.level.transmitted for s in solved]),
            "unscattered_transmittance": column([s.unscattered_down for s in solved]),
            "absorbed": (layer_dims, absorbed, {"units": "1"}),
            "residual": column(balance),
            "reflectance_diffuse_incidence": column([s.level.reflected_diffuse for s in solved]),
            "transmittance_diffuse_incidence": column([s.level.transmitted_diffuse for s in solved]),
            "absorbed_diffuse_incidence": (
                layer_dims,
                np.array([s.level.absorbed_diffuse for s in solved]),
                {"units": "1"},
            ),
            **angular,
            "error_estimate": column([s.error for s in solved]),
            "nodes": ("wavelength", np.array([s.nodes for s in solved])),
            "converged": ("wavelength", np.array([s.error <= tolerance for s in solved])),
        },
        coords={
            "wavelength": ("wavelength", stack.wavelength_nm, {"units": "nm"}),
            "layer": [x.name for x in stack.layers],
            **coords,
            "solid_angle": weights["mu_o"],
            "solid_angle_below": weights["mu_t"],
        },
        attrs={
            "solver": "adding-doubling",
            "mu0": mu0,
            "tolerance": tolerance,
            "angular_breaks": np.array(above.breaks),
            "notes": "; ".join(notes),
        },
    )
