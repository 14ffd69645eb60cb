"""Which of NLopt's algorithms do what, and its stop codes in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from livlab.errors import InputError


@dataclass(frozen=True)
class Algorithm:
    """One of NLopt's algorithms.

    Parameters
    ----------
    name
        NLopt's name.
    is_global
        Searches the whole box, so it needs a finite one and stops by a limit.
    gradient
        Needs the objective's gradient.
    source
        Where it was published.
    most
        Largest number of parameters it takes.
    """

    name: str
    is_global: bool
    gradient: bool
    source: str
    most: int = 1_000_000


ALGORITHMS = {
    entry.name: entry
    for entry in (
        Algorithm("GN_CRS2_LM", True, False, "Kaelo & Ali 2006"),
        Algorithm("GN_DIRECT_L", True, False, "Gablonsky & Kelley 2001"),
        Algorithm("G_MLSL_LDS", True, False, "Kucherenko & Sytsko 2005"),
        Algorithm("GN_ISRES", True, False, "Runarsson & Yao 2005"),
        Algorithm("GN_AGS", True, False, "Sergeyev & Markin 1995", most=10),
        Algorithm("LD_MMA", False, True, "Svanberg 2002"),
        Algorithm("LD_SLSQP", False, True, "Kraft 1994"),
        Algorithm("LD_LBFGS", False, True, "Liu & Nocedal 1989"),
        Algorithm("LN_BOBYQA", False, False, "Powell 2009"),
        Algorithm("LN_SBPLX", False, False, "Rowan 1990"),
    )
}


def choose(algorithm: str | tuple[str, ...], *, free: int, gradient: bool, boxed: bool) -> tuple[Algorithm, ...]:
    """The stages to run: the named ones, or with "auto" a choice by what the problem offers.

    With a gradient: LD_SLSQP. Without one: GN_CRS2_LM and then LN_BOBYQA if every parameter has a finite box, else
    LN_BOBYQA alone.

    Raises
    ------
    InputError
        An unknown name, a gradient method without a gradient, too many parameters, a global one after a local one.
    """
    if algorithm == "auto":
        names: tuple[str, ...] = ("LD_SLSQP",) if gradient else ("GN_CRS2_LM", "LN_BOBYQA") if boxed else ("LN_BOBYQA",)
    else:
        names = (algorithm,) if isinstance(algorithm, str) else tuple(algorithm)
    stages: list[Algorithm] = []
    for name in names:
        if name not in ALGORITHMS:
            raise InputError.of("algorithm", name, f"must be auto or of {', '.join(ALGORITHMS)}", "Name one of these.")
        stage = ALGORITHMS[name]
        if stage.gradient and not gradient:
            raise InputError.of("algorithm", name, "needs the gradient", "Give gradient=, or name an LN_ algorithm.")
        if stage.is_global and not boxed:
            raise InputError.of(
                "algorithm", name, "searches the whole box, but some bounds are infinite", "Give finite bounds."
            )
        if free > stage.most:
            raise InputError.of(
                "algorithm", name, f"takes at most {stage.most} free parameters, not {free}", "Fix some, or use CRS2."
            )
        if stage.is_global and stages and not stages[-1].is_global:
            raise InputError.of("algorithm", names, "goes from a local search to a global one", "Put the global first.")
        stages.append(stage)
    if not stages:
        raise InputError.of("algorithm", algorithm, "names no algorithm", "Name one, or auto.")
    return tuple(stages)


def make(stage: Algorithm, dimension: int, *, gradient: bool) -> Any:
    """NLopt's object for a stage; MLSL gets the local search it needs."""
    import nlopt

    opt = nlopt.opt(getattr(nlopt, stage.name), dimension)
    if stage.name == "G_MLSL_LDS":
        local = nlopt.opt(nlopt.LD_LBFGS if gradient else nlopt.LN_BOBYQA, dimension)
        local.set_xtol_abs(1e-7)
        local.set_ftol_rel(1e-9)
        opt.set_local_optimizer(local)
    return opt


STOPS = {
    1: ("success", True),
    2: ("the value fell to the one asked for", True),
    3: ("the value no longer changed (value tolerance)", True),
    4: ("the parameters no longer changed (parameter tolerance)", True),
    5: ("the limit of evaluations was reached", False),
    6: ("the limit of time was reached", False),
    -1: ("NLopt failed without a reason; the best point seen is kept", False),
    -2: ("NLopt refused the problem; the best point seen is kept", False),
    -3: ("NLopt ran out of memory; the best point seen is kept", False),
    -4: ("rounding left nothing to gain (ROUNDOFF_LIMITED)", True),
    -5: ("stopped from outside (FORCED_STOP)", False),
}
