"""The one door to NLopt for an objective that is a number."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from livlab.optimise.guard import Callback, Gradient, Objective
from livlab.optimise.parameters import Parameter, ParameterSpace
from livlab.optimise.result import OptimiseResult
from livlab.optimise.search import SearchOptions, search


def minimise(
    objective: Objective,
    parameters: Sequence[Parameter] | ParameterSpace,
    *,
    gradient: Gradient | None = None,
    algorithm: str | tuple[str, ...] = "auto",
    starts: int | Sequence[Mapping[str, float]] = 1,
    max_evaluations: int | None = None,
    max_seconds: float = math.inf,
    value_tolerance: float = 1e-12,
    parameter_tolerance: float = 1e-8,
    seed: int = 0,
    callback: Callback | None = None,
    one_sigma: float = 0.5,
    warn: bool = True,
    test: bool = True,
) -> OptimiseResult:
    """Minimise an objective over named parameters with NLopt (Johnson 2007).

    Global stages run once over the box; then the local stages run from the best point and from every further start.

    Parameters
    ----------
    objective
        Takes a mapping of all parameters by name, gives a number. A call that raises or gives no finite number is
        recorded with infinite cost and the search goes on.
    parameters
        See `Parameter`.
    gradient
        Takes the same mapping, gives the objective's derivative by each parameter (missing names count as 0),
        without the priors' part.
    algorithm
        "auto", or the name of one stage, or of several from global to local: GN_CRS2_LM, GN_DIRECT_L, G_MLSL_LDS,
        GN_ISRES, GN_AGS; LD_MMA, LD_SLSQP, LD_LBFGS with a gradient; LN_BOBYQA, LN_SBPLX without. "auto" is LD_SLSQP
        with a gradient, else GN_CRS2_LM then LN_BOBYQA in a finite box, else LN_BOBYQA.
    starts
        How many, the first at the parameters' own starts and the others spread by a scrambled Sobol sequence over
        the box (about the start where a bound is infinite); or a list of mappings.
    max_evaluations, max_seconds
        Limits of the whole call; 500 evaluations for each free parameter and start (plus one) if not given.
    value_tolerance
        A stage ends where the value changes by less than this share.
    parameter_tolerance
        A stage ends where no scaled parameter (its box is 1) changes by more.
    seed
        Of the starts and of NLopt's random algorithms.
    callback
        Gets (evaluation, values, value) after each call; stops the search by returning False.
    one_sigma
        Rise of the objective that marks one standard deviation: ½ of a negative log-likelihood, 1 of a χ².
    warn
        Also raise each warning of the result as a `FitWarning`.
    test
        Test the end (docs/optimise.md says how), go on from one that is no minimum, and call it converged only if it
        passes. Without the test nothing is called converged.

    Returns
    -------
    OptimiseResult
        The best point seen, whatever stopped the search.

    Raises
    ------
    InputError
        Unusable parameters, starts or limits; an algorithm that does not fit; an objective that is nowhere finite.
    Interrupted
        The user stopped it before any point had a finite value.

    Examples
    --------
    >>> box = [Parameter("a", -2, 2, 0.5), Parameter("b", 1e-3, 10, 1.0, transform="log")]
    >>> found = minimise(lambda p: (p["a"] - 1) ** 2 + (p["b"] - 0.25) ** 2, box, algorithm="LN_BOBYQA")
    >>> round(found.best["a"], 5), round(found.best["b"], 5)
    (1.0, 0.25)
    """
    space = parameters if isinstance(parameters, ParameterSpace) else ParameterSpace(parameters)
    options = SearchOptions(
        algorithm=algorithm,
        starts=starts,
        max_evaluations=max_evaluations,
        max_seconds=max_seconds,
        value_tolerance=value_tolerance,
        parameter_tolerance=parameter_tolerance,
        seed=seed,
        callback=callback,
        one_sigma=one_sigma,
        warn=warn,
        test=test,
    )
    return search(objective, space, options, gradient=gradient)
