"""Where each solver of the ladder holds: at which wavelengths of a stack, seen how, and why not elsewhere."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, cast, get_args

import numpy as np
from numpy.typing import NDArray

from livlab.errors import InputError
from livlab.model.tissue.phase.functions import Isotropic
from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport import diffusion, kubelka_munk
from livlab.model.transport.geometry import Readout
from livlab.model.transport.moments import reduced_coefficients
from livlab.units import FloatArray

SolverName = Literal["kubelka-munk", "diffusion", "adding-doubling", "ledger", "walk analog", "walk expected"]
SOLVERS: tuple[SolverName, ...] = get_args(SolverName)
"""From the crudest to the most general."""

DIFFUSION_NEAREST = 4.0
"""Transport paths 1/(µ_a + µ_s') from the beam within which light that leaves is not yet diffuse."""

DIFFUSION_STEEPEST = math.radians(20.0)
"""Angle of incidence up to which the dipole's source depth serves: at 40° its total is 6 % off, at 70° 10 %."""


@dataclass(frozen=True)
class Domain:
    """Where a solver holds.

    Attributes
    ----------
    solver
        Its name.
    valid
        (W,) whether it holds at each wavelength.
    reasons
        What it does not know or cannot stand, with the wavelengths concerned; none if it holds everywhere.
    possible
        Whether it gives a number at all.
    instead
        What to use where it does not hold.
    """

    solver: SolverName
    valid: NDArray[np.bool_]
    reasons: tuple[str, ...]
    possible: bool
    instead: str

    def refusal(self) -> InputError:
        """The error that says why, and what to use."""
        return InputError.of("solver", self.solver, "; ".join(self.reasons), f"Use {self.instead}.")


class _Judge:
    """Gathers objections to a solver."""

    def __init__(self, solver: SolverName, stack: OpticalStack, instead: str) -> None:
        self._solver, self._instead, self._nm = solver, instead, stack.wavelength_nm
        self._valid = np.ones(len(self._nm), dtype=bool)
        self._reasons: list[str] = []
        self._possible = True

    def never(self, reason: str) -> None:
        """It cannot answer at all."""
        self._possible = False
        self.outside(np.ones(len(self._nm), dtype=bool), reason)

    def outside(self, where: NDArray[np.bool_] | bool, reason: str) -> None:
        """It answers, and is not to be believed at these wavelengths."""
        mask = np.broadcast_to(np.asarray(where, dtype=bool), self._valid.shape)
        if not mask.any():
            return
        self._valid &= ~mask
        at = "" if mask.all() else f" at {listed(self._nm[mask])} nm"
        self._reasons.append(reason + at)

    def verdict(self) -> Domain:
        return Domain(self._solver, self._valid, tuple(self._reasons), self._possible, self._instead)


def domain(solver: str, stack: OpticalStack, view: Readout) -> Domain:
    """Where a solver holds for a stack and what is asked of it.

    Parameters
    ----------
    solver
        One of `SOLVERS`.
    stack
        The layers.
    view
        The instrument in a solver's terms.

    Raises
    ------
    InputError
        If there is no such solver.

    Examples
    --------
    >>> from livlab.model.tissue.phase.functions import Isotropic
    >>> from livlab.model.tissue.stack import plain_stack
    >>> from livlab.model.transport.geometry import total_reflectance
    >>> thin = plain_stack([(1.4, 0.01, 10.0, 0.1, Isotropic())])
    >>> domain("kubelka-munk", thin, total_reflectance()).reasons
    ('a reduced depth of 1 is too thin for two fluxes (3 at least)',)
    """
    if solver == "kubelka-munk":
        return _kubelka_munk(stack, view)
    if solver == "diffusion":
        return _diffusion(stack, view)
    if solver == "adding-doubling":
        return _adding_doubling(stack, view)
    if solver == "ledger":
        return _ledger(stack, view)
    if solver in ("walk analog", "walk expected"):
        return _Judge(cast(SolverName, solver), stack, "nothing else").verdict()
    raise InputError.of("solver", solver, f"must be auto or one of {', '.join(SOLVERS)}", "Name one of them.")


def whole_plane(view: Readout) -> bool:
    """Whether no light is told from other by where it leaves, save that it misses a port about the beam."""
    return len(view.tally.radius_edges) in (0, 2) and view.tally.radius[0] == 0.0


def _kubelka_munk(stack: OpticalStack, view: Readout) -> Domain:
    judge = _Judge("kubelka-munk", stack, "'adding-doubling' or 'walk expected'")
    _laterally_blind(judge, view)
    judge.outside(bool(view.tally.theta_edges), "two fluxes know no angle of exit: inside, all are taken alike")
    depth = np.zeros(len(stack.wavelength_nm))
    albedo = np.ones(len(depth))
    for layer in stack.layers:
        absorption, reduced = reduced_coefficients(layer)
        scatters = reduced > 0
        depth[scatters] += reduced[scatters] * layer.thickness_mm
        albedo = np.minimum(albedo, _share(reduced, absorption))
    least = kubelka_munk.LEAST_REDUCED_DEPTH
    thin, dark = depth < least, albedo < kubelka_munk.LEAST_REDUCED_ALBEDO
    if thin.any():
        judge.outside(thin, f"a reduced depth of {depth.min():.2g} is too thin for two fluxes ({least:g} at least)")
    if dark.any():
        judge.outside(dark, _too_dark(albedo, kubelka_munk.LEAST_REDUCED_ALBEDO))
    return judge.verdict()


def _diffusion(stack: OpticalStack, view: Readout) -> Domain:
    judge = _Judge("diffusion", stack, "'adding-doubling' or 'walk expected'")
    if not whole_plane(view):
        judge = _Judge("diffusion", stack, "'walk expected'")
    try:
        albedo = diffusion.diffusion(stack)["reduced_albedo"].to_numpy()
    except InputError as error:
        judge.never(error.message.rstrip("."))
        return judge.verdict()
    dark = albedo < diffusion.LEAST_REDUCED_ALBEDO
    if dark.any():
        judge.outside(dark, _too_dark(albedo, diffusion.LEAST_REDUCED_ALBEDO))
    _endless(judge, view)
    judge.outside(view.source.angle_rad > DIFFUSION_STEEPEST, "the dipole's source lies as deep as for upright light")
    judge.outside(bool(view.tally.theta_edges), "the dipole's light by angle of exit is up to 45 % off")
    if view.tally.radius_edges:
        judge.outside(
            view.source.extended and whole_plane(view), "the dipole takes the beam for a pencil in the port's middle"
        )
        absorption, reduced = reduced_coefficients(stack.layers[0])
        nearest = view.tally.radius[1] if whole_plane(view) else view.tally.radius[0]
        paths = nearest * (absorption + reduced)
        near = paths < DIFFUSION_NEAREST
        if near.any():
            judge.outside(
                near,
                f"{paths.min():.2g} transport paths from the beam light is not yet diffuse ({DIFFUSION_NEAREST:g} are)",
            )
    return judge.verdict()


def _adding_doubling(stack: OpticalStack, view: Readout) -> Domain:
    judge = _Judge("adding-doubling", stack, "'walk expected'")
    _laterally_blind(judge, view)
    for layer in stack.layers:
        for i in layer.interactions:
            scatters = np.asarray(i.rate * i.albedo > 0)
            judge.outside(
                scatters & (i.absorb_below_mm > 0),
                f"absorption of {i.name} on short free paths is taken in the mean",
            )
    _turned(judge, stack)
    return judge.verdict()


def _ledger(stack: OpticalStack, view: Readout) -> Domain:
    judge = _Judge("ledger", stack, "'walk expected'")
    lateral = view.half_width_mm is not None or bool(view.tally.radius_edges)
    if lateral and any(i.redirect == "cos" for x in stack.layers for i in x.interactions):
        judge.never("a factor cos θ has mean zero, which leaves no weight to record")
    if len(np.unique(stack.wavelength_nm)) != len(stack.wavelength_nm):
        judge.never("a wavelength repeats")
    if not lateral:
        _turned(judge, stack)
    return judge.verdict()


def _turned(judge: _Judge, stack: OpticalStack) -> None:
    """A redirect factor taken in its mean: right for an isotropic scatterer, whose next azimuth is any."""
    for layer in stack.layers:
        for i in layer.interactions:
            if i.redirect != "none":
                turned = np.array([not isinstance(p, Isotropic) for p in i.phases])
                judge.outside(
                    np.asarray(i.rate * i.albedo > 0) & turned,
                    f"the azimuths that the redirect factor of {i.name} favours are lost",
                )


def _laterally_blind(judge: _Judge, view: Readout) -> None:
    if not whole_plane(view):
        judge.never("it knows no lateral distance, which the detector hangs on")
        return
    _endless(judge, view)
    if view.tally.radius_edges and math.isfinite(view.tally.radius[1]):
        judge.outside(True, f"the port of {2 * view.tally.radius[1]:g} mm is taken as endless: nothing misses it")


def _endless(judge: _Judge, view: Readout) -> None:
    if view.half_width_mm is not None:
        side = 2 * view.half_width_mm
        judge.outside(True, f"the sample of {side:g} mm is taken as endless: nothing is lost sideways")


def _share(part: FloatArray, rest: FloatArray) -> FloatArray:
    whole = part + rest
    return np.where(whole > 0, part / np.where(whole > 0, whole, 1.0), 1.0)


def _too_dark(albedo: FloatArray, least: float) -> str:
    return f"a reduced albedo of {albedo.min():.3g} is not close enough to 1 ({least:g} at least)"


def listed(nm: FloatArray) -> str:
    """Wavelengths for a message."""
    if len(nm) > 6:
        return f"{len(nm)} wavelengths from {nm[0]:g} to {nm[-1]:g}"
    return ", ".join(f"{x:g}" for x in nm)
