"""Adding–doubling in plane layers of unequal index: the deterministic reference for flat stacks.

Solves the azimuth-averaged scalar transfer equation with Fresnel surfaces (unpolarised at each interface)
on nodes that all layers share (`quadrature`), with phase functions averaged over the nodes' solid angles,
thin layers doubled and added (`doubling`), at rising node counts until the totals stand still.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.angular import angular_grid, cone_fraction, exit_flux, flux_at
from livlab.model.transport.doubling import (
    Below,
    add_interface,
    add_layer,
    clear_below,
    homogeneous_layer,
    redistribution,
)
from livlab.model.transport.fresnel import fresnel, incoherent_stack
from livlab.model.transport.moments import LayerOptics, Moments, layer_optics
from livlab.model.transport.quadrature import AngularGrid
from livlab.units import FloatArray

__all__ = ["adding_doubling", "cone_fraction", "exit_flux"]

LEVELS = (8, 12, 16, 24, 32, 48, 64, 96)
"""Nodes per interval that are tried in turn."""

HIGHEST_ORDER = 1024
"""Default limit of the Legendre order; a longer tail of moments is taken as a forward peak (delta-M)."""


@dataclass(frozen=True)
class _Fluxes:
    """What becomes of light of one incidence: reflected, transmitted, and absorbed per layer."""

    reflected: float
    transmitted: float
    absorbed: FloatArray


@dataclass(frozen=True)
class _Level:
    """What one node count gives: fluxes of the beam and of diffuse light, the beam's exit flux per solid angle."""

    grid: AngularGrid
    beam: _Fluxes
    diffuse: _Fluxes
    angular_up: FloatArray
    angular_down: FloatArray

    def distance(self, other: _Level) -> float:
        """Largest difference of the totals."""
        pairs = ((self.beam, other.beam), (self.diffuse, other.diffuse))
        return max(max(abs(a.reflected - b.reflected), abs(a.transmitted - b.transmitted)) for a, b in pairs)


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
        longer, as if each collision were independent (said in `attrs["notes"]`).
    mu0
        Cosine of incidence in the medium above, in [1e-6, 1]; 1 is a true collimated normal beam.
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
    The error estimate is the largest difference of the four totals between the last two node counts, so it
    is the error of the coarser one (and at least a twentieth of the difference before that); the result's own
    is usually 10 to 1000 times less. A half-space without absorption returns everything, by the limit.

    Examples
    --------
    >>> from livlab.model.tissue.stack import plain_stack
    >>> from livlab.model.tissue.phase.functions import HenyeyGreenstein
    >>> slab = plain_stack([(1.0, 1.0, 9.0, 0.2, HenyeyGreenstein(0.75))])
    >>> result = adding_doubling(slab)
    >>> round(float(result.reflectance[0]), 5), round(float(result.transmittance[0]), 5)
    (0.09739, 0.66096)
    """
    if not 1e-6 <= mu0 <= 1:
        raise InputError.of("mu0", mu0, "must be in [1e-6, 1]", "Give the cosine of incidence above the stack.")
    if nodes is not None and (nodes != int(nodes) or nodes < 4):
        raise InputError.of("nodes", nodes, "must be an integer of at least 4", "Leave it out to let livlab choose.")
    if not (math.isfinite(tolerance) and tolerance > 0):
        raise InputError.of("tolerance", tolerance, "must be positive", "Give an absolute error, such as 1e-6.")
    if order != int(order) or order < 1:
        raise InputError.of("order", order, "must be an integer of at least 1", "Leave it out.")
    moments = Moments(int(order), min(1e-7, 0.03 * tolerance))
    solved = [_solve(stack, k, mu0, nodes, tolerance, moments) for k in range(len(stack.wavelength_nm))]
    return _dataset(stack, mu0, tolerance, solved, _notes(stack, moments))


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
    stack: OpticalStack, index: int, mu0: float, nodes: int | None, tolerance: float, moments: Moments
) -> _Solved:
    n_above, n_below = float(stack.n_above[index]), float(stack.n_below[index])
    own = [float(layer.n[index]) for layer in stack.layers]
    if math.isinf(stack.layers[-1].thickness_mm):
        n_below = own[-1]
    indices = [n_above, *own, n_below]
    first = AngularGrid.of(indices, 4, (n_above, mu0))
    beam = (first.snap(n_above), mu0)
    media = [layer_optics(layer, index, first.snap(n), moments) for layer, n in zip(stack.layers, own, strict=True)]
    counts = LEVELS if nodes is None else (max(4, 2 * int(nodes) // 3), int(nodes))
    previous, error, last, level, used = None, math.inf, 0.0, None, 0
    for used in counts:
        level = _level(AngularGrid.of(indices, used, beam), first.snap(n_above), media, first.snap(n_below))
        if previous is not None:
            # With 4 nodes asked both counts coincide: then nothing is known of the error.
            step = level.distance(previous[1]) if previous[0] < used else math.nan
            # Two counts may agree by chance: never claim more than a twentieth of the step before.
            error = max(step, 0.05 * last)
            last = step
            if nodes is None and error <= tolerance:
                break
        previous = (used, level)
    assert level is not None
    depths = [0.0 if m.absorption + m.scattering == 0 else (m.absorption + m.scattering) * m.thickness for m in media]
    up, down = incoherent_stack([first.snap(n) for n in indices], mu0, depths)
    specular = float(fresnel(first.snap(n_above), media[0].n, mu0))
    return _Solved(level, error, used, specular, max(up - specular, 0.0), down)


def _level(grid: AngularGrid, n_above: float, media: list[LayerOptics], n_below: float) -> _Level:
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


def _totals(grid: AngularGrid, n_above: float, n_below: float, whole: Below) -> _Level:
    flux = grid.flux()
    upper, lower = grid.active(n_above), grid.active(n_below)
    diffuse = flux[upper] / flux[upper].sum()
    up, down = flux[upper] > 0, flux[lower] > 0
    # A node's flux over its solid angle 2π s ds / (n² µ).
    up_cosines, down_cosines = grid.cosines(n_above)[up], grid.cosines(n_below)[down]
    reflected, transmitted = whole.reflectance, whole.transmittance
    return _Level(
        grid,
        beam=_Fluxes(float(reflected[:, 0].sum()), float(transmitted[:, 0].sum()), whole.absorbed[:, 0]),
        diffuse=_Fluxes(
            float(reflected.sum(axis=0) @ diffuse),
            float(transmitted.sum(axis=0) @ diffuse),
            whole.absorbed @ diffuse,
        ),
        angular_up=reflected[up, 0] * up_cosines * n_above**2 / (2 * math.pi * flux[upper][up]),
        angular_down=transmitted[down, 0] * down_cosines * n_below**2 / (2 * math.pi * flux[lower][down]),
    )


def _notes(stack: OpticalStack, moments: Moments) -> list[str]:
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
    angular, directions, breaks = _angular(stack, solved)

    def column(values: list[float]) -> tuple[str, FloatArray, dict[str, str]]:
        return ("wavelength", np.array(values), {"units": "1"})

    def by_layer(values: list[FloatArray]) -> tuple[tuple[str, str], FloatArray, dict[str, str]]:
        return (("wavelength", "layer"), np.array(values), {"units": "1"})

    beam, diffuse = [s.level.beam for s in solved], [s.level.diffuse for s in solved]
    reflectance = [x.reflected - s.specular for x, s in zip(beam, solved, strict=True)]
    balance = [
        1.0 - s.specular - r - x.transmitted - float(x.absorbed.sum())
        for x, s, r in zip(beam, solved, reflectance, strict=True)
    ]
    return xr.Dataset(
        {
            "reflectance": column(reflectance),
            "specular": column([s.specular for s in solved]),
            "unscattered_reflectance": column([s.unscattered_up for s in solved]),
            "transmittance": column([x.transmitted for x in beam]),
            "unscattered_transmittance": column([s.unscattered_down for s in solved]),
            "absorbed": by_layer([x.absorbed for x in beam]),
            "residual": column(balance),
            "reflectance_diffuse_incidence": column([x.reflected for x in diffuse]),
            "transmittance_diffuse_incidence": column([x.transmitted for x in diffuse]),
            "absorbed_diffuse_incidence": by_layer([x.absorbed for x in diffuse]),
            **angular,
            "error_estimate": column([s.error for s in solved]),
            "nodes": ("wavelength", np.array([s.nodes for s in solved])),
            "converged": ("wavelength", np.array([s.error <= tolerance for s in solved])),
        },
        coords={
            "wavelength": ("wavelength", stack.wavelength_nm, {"units": "nm"}),
            "layer": [x.name for x in stack.layers],
            **directions,
        },
        attrs={
            "solver": "adding-doubling",
            "mu0": mu0,
            "tolerance": tolerance,
            "angular_breaks": np.array(breaks),
            "notes": "; ".join(notes),
        },
    )


def _angular(stack: OpticalStack, solved: list[_Solved]) -> tuple[dict[str, Any], dict[str, Any], tuple[float, ...]]:
    """Scattered flux per solid angle, the exit directions that all wavelengths share, and their breaks above."""
    n_under = stack.layers[-1].n if math.isinf(stack.layers[-1].thickness_mm) else stack.n_below
    above, under = angular_grid(stack, stack.n_above), angular_grid(stack, n_under)
    angular: dict[str, Any] = {}
    cosines: dict[str, Any] = {}
    weights: dict[str, Any] = {}
    for name, grid, dim, solid_angle in (
        ("reflectance", above, "mu_o", "solid_angle"),
        ("transmittance", under, "mu_t", "solid_angle_below"),
    ):
        top = grid.breaks[-1]
        mu = grid.cosines(top)[1:]
        share = np.sqrt((1 - mu) * (1 + mu))
        rows = []
        for k, s in enumerate(solved):
            n = float((stack.n_above if name == "reflectance" else n_under)[k])
            values = s.level.angular_up if name == "reflectance" else s.level.angular_down
            rows.append(flux_at(s.level.grid, values, s.level.grid.snap(n) * share))
        angular[f"{name}_angular"] = (("wavelength", dim), np.array(rows), {"units": "1/sr"})
        cosines[dim] = (dim, mu, {"units": "1"})
        weights[solid_angle] = (dim, 2 * math.pi * grid.flux()[1:] / (top * top * mu), {"units": "sr"})
    return angular, {**cosines, **weights}, above.breaks
