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
from livlab.model.transport.angular import ExitDirections, cone_error, cone_fraction, exit_flux, flux_at
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
from livlab.model.transport.refinement import ANGULAR, Quantities, Unresolved, stated_errors
from livlab.units import FloatArray

__all__ = ["adding_doubling", "cone_error", "cone_fraction", "exit_flux"]

LEVELS = (8, 12, 16, 24, 32, 48, 64, 96)
"""Nodes per interval that are tried in turn."""

HIGHEST_ORDER = 1024
"""Default limit of the Legendre order; a longer tail of moments is taken as a forward peak (delta-M)."""


@dataclass(frozen=True)
class _Exits:
    """Exit directions above and below."""

    above: ExitDirections
    below: ExitDirections

    @classmethod
    def of(cls, stack: OpticalStack) -> _Exits:
        under = stack.layers[-1].n if math.isinf(stack.layers[-1].thickness_mm) else stack.n_below
        return cls(ExitDirections.of(stack, stack.n_above), ExitDirections.of(stack, under))


@dataclass(frozen=True)
class _Wish:
    """What is asked of a solution.

    Attributes
    ----------
    mu0
        Cosine of incidence.
    counts
        Node counts to try in turn, ascending.
    tolerance
        Error at which to stop; None: with the last count.
    mu_min
        Cone that is asked for; None: totals are.
    """

    mu0: float
    counts: tuple[int, ...]
    tolerance: float | None
    mu_min: float | None

    def error(self, errors: Quantities, exits: _Exits) -> float:
        """Largest stated error of what is asked."""
        if self.mu_min is not None:
            return float(exits.above.cone(errors["reflectance_angular"], self.mu_min))
        return max(float(e.max(initial=0.0)) for name, e in errors.items() if name not in ANGULAR)


def adding_doubling(
    stack: OpticalStack,
    *,
    mu0: float = 1.0,
    nodes: int | None = None,
    tolerance: float = 1e-6,
    order: int = HIGHEST_ORDER,
    mu_min: float | None = None,
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
        Wanted absolute error of what is asked, > 0: of all totals, unless `mu_min` asks for another thing.
    order
        Highest Legendre moment of the phase functions that is kept, ≥ 1.
    mu_min
        Least cosine of exit, in [0, 1], of a cone about the normal: its share of the light (`cone_fraction`) is then
        what is asked, whose error in a narrow cone and the totals' have little to do with each other.

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
        `solid_angle` and `solid_angle_below`. Each but the exact ones and `residual` has a stated error of its own,
        `reflectance_error` and so on. `error_estimate`: that of what is asked; `nodes`, `converged`.

    Raises
    ------
    InputError
        A parameter out of its bounds.

    Notes
    -----
    A stated error is the difference between the last two node counts, so it is the error of the coarser one; the
    result's own is usually 10 to 1000 times less. It is more where convergence is slow or two counts may agree by
    chance, in layers too thin for the nodes (`refinement`), and for moments left out. A half-space without absorption
    returns everything, by the limit.

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
    if mu_min is not None and not 0 <= mu_min <= 1:
        raise InputError.of("mu_min", mu_min, "must be in [0, 1]", "Give the cosine of the cone's half-angle.")
    moments = Moments(int(order), min(1e-7, 0.03 * tolerance))
    counts = LEVELS if nodes is None else (max(4, 2 * int(nodes) // 3), int(nodes))
    wish = _Wish(mu0, tuple(dict.fromkeys(counts)), tolerance if nodes is None else None, mu_min)
    exits = _Exits.of(stack)
    solved = [_solve(stack, k, wish, exits, moments) for k in range(len(stack.wavelength_nm))]
    return _dataset(stack, mu0, tolerance, solved, exits, _notes(stack, moments, solved, tolerance))


@dataclass(frozen=True)
class _Solved:
    """One wavelength's answer, and the stated error of each quantity and of what was asked."""

    values: Quantities
    errors: Quantities
    error: float
    nodes: int
    specular: float
    unscattered_up: float
    unscattered_down: float


def _solve(stack: OpticalStack, index: int, wish: _Wish, exits: _Exits, moments: Moments) -> _Solved:
    n_above, n_below, mu0 = float(stack.n_above[index]), float(stack.n_below[index]), wish.mu0
    own = [float(layer.n[index]) for layer in stack.layers]
    if math.isinf(stack.layers[-1].thickness_mm):
        n_below = own[-1]
    indices = [n_above, *own, n_below]
    first = AngularGrid.of(indices, 4, (n_above, mu0))
    beam = (first.snap(n_above), mu0)
    media = [layer_optics(layer, index, first.snap(n), moments) for layer, n in zip(stack.layers, own, strict=True)]
    specular = float(fresnel(first.snap(n_above), media[0].n, mu0))
    found: list[Quantities] = []
    errors: Quantities = {}
    error, used = math.nan, 0
    for used in wish.counts:
        grid = AngularGrid.of(indices, used, beam)
        whole = _level(grid, first.snap(n_above), media, first.snap(n_below))
        found.append(_quantities(grid, first.snap(n_above), first.snap(n_below), whole, specular, exits))
        errors = stated_errors(found, Unresolved.of(grid, media, moments.negligible))
        error = wish.error(errors, exits)
        if wish.tolerance is not None and error <= wish.tolerance:
            break
    depths = [0.0 if m.absorption + m.scattering == 0 else (m.absorption + m.scattering) * m.thickness for m in media]
    up, down = incoherent_stack([first.snap(n) for n in indices], mu0, depths)
    return _Solved(found[-1], errors, error, used, specular, max(up - specular, 0.0), down)


def _level(grid: AngularGrid, n_above: float, media: list[LayerOptics], n_below: float) -> Below:
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
    return add_interface(grid, n_above, under, below)


def _quantities(
    grid: AngularGrid, n_above: float, n_below: float, whole: Below, specular: float, exits: _Exits
) -> dict[str, FloatArray]:
    """Everything that is told of the stack at one node count."""
    flux = grid.flux()
    upper, lower = grid.active(n_above), grid.active(n_below)
    diffuse = flux[upper] / flux[upper].sum()
    reflected, transmitted = whole.reflectance, whole.transmittance

    def by_angle(part: FloatArray, nodes: Any, n: float, directions: ExitDirections) -> FloatArray:
        # A node's flux over its solid angle 2π s ds / (n² µ).
        up = flux[nodes] > 0
        known = part[up, 0] * grid.cosines(n)[up] * n**2 / (2 * math.pi * flux[nodes][up])
        return flux_at(grid, known, n * directions.sines)

    return {
        "reflectance": np.asarray(reflected[:, 0].sum() - specular),
        "transmittance": np.asarray(transmitted[:, 0].sum()),
        "absorbed": whole.absorbed[:, 0],
        "reflectance_diffuse_incidence": np.asarray(reflected.sum(axis=0) @ diffuse),
        "transmittance_diffuse_incidence": np.asarray(transmitted.sum(axis=0) @ diffuse),
        "absorbed_diffuse_incidence": whole.absorbed @ diffuse,
        "reflectance_angular": by_angle(reflected, upper, n_above, exits.above),
        "transmittance_angular": by_angle(transmitted, lower, n_below, exits.below),
    }


def _notes(stack: OpticalStack, moments: Moments, solved: list[_Solved], tolerance: float) -> list[str]:
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
    short = np.array([not s.error <= tolerance for s in solved])
    if short.any():
        nm = ", ".join(f"{x:g}" for x in stack.wavelength_nm[short][:6]) + (", ..." if short.sum() > 6 else "")
        worst = max(s.error for s, missed in zip(solved, short, strict=True) if missed)
        notes.append(
            f"adding-doubling: the wished error of {tolerance:.2g} was not reached at {nm} nm with "
            f"{max(s.nodes for s in solved)} nodes an interval: {worst:.2g}"
        )
    return notes


_UNITS = dict.fromkeys(ANGULAR, "1/sr")
_DIMS: dict[str, tuple[str, ...]] = {
    "reflectance": ("wavelength",),
    "transmittance": ("wavelength",),
    "absorbed": ("wavelength", "layer"),
    "reflectance_diffuse_incidence": ("wavelength",),
    "transmittance_diffuse_incidence": ("wavelength",),
    "absorbed_diffuse_incidence": ("wavelength", "layer"),
    "reflectance_angular": ("wavelength", "mu_o"),
    "transmittance_angular": ("wavelength", "mu_t"),
}


def _dataset(
    stack: OpticalStack, mu0: float, tolerance: float, solved: list[_Solved], exits: _Exits, notes: list[str]
) -> xr.Dataset:
    def column(values: list[float]) -> tuple[str, FloatArray, dict[str, str]]:
        return ("wavelength", np.array(values), {"units": "1"})

    told: dict[str, Any] = {
        "specular": column([s.specular for s in solved]),
        "unscattered_reflectance": column([s.unscattered_up for s in solved]),
        "unscattered_transmittance": column([s.unscattered_down for s in solved]),
        "residual": column([1.0 - s.specular - _accounted(s.values) for s in solved]),
    }
    for name, dims in _DIMS.items():
        about = {"units": _UNITS.get(name, "1")}
        told[name] = (dims, np.array([s.values[name] for s in solved]), about)
        told[f"{name}_error"] = (dims, np.array([s.errors[name] for s in solved]), about)
    sides = (("mu_o", "solid_angle", exits.above), ("mu_t", "solid_angle_below", exits.below))
    return xr.Dataset(
        {
            **told,
            "error_estimate": column([s.error for s in solved]),
            "nodes": ("wavelength", np.array([s.nodes for s in solved])),
            "converged": ("wavelength", np.array([s.error <= tolerance for s in solved])),
        },
        coords={
            "wavelength": ("wavelength", stack.wavelength_nm, {"units": "nm"}),
            "layer": [x.name for x in stack.layers],
            **{dim: (dim, side.cosines, {"units": "1"}) for dim, _, side in sides},
            **{weight: (dim, side.solid_angle, {"units": "sr"}) for dim, weight, side in sides},
        },
        attrs={
            "solver": "adding-doubling",
            "mu0": mu0,
            "tolerance": tolerance,
            "angular_breaks": np.array(exits.above.breaks),
            "notes": "; ".join(notes),
        },
    )


def _accounted(values: Quantities) -> float:
    return float(values["reflectance"] + values["transmittance"] + values["absorbed"].sum())
