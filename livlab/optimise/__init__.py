"""Fits: named parameters, the one door to NLopt, and what the data say about the result.

`minimise` finds the parameters, `least_squares` does so for residuals with their Jacobian, `covariance` and
`profile` give uncertainties, `identifiability` names what the data do not hold, `bootstrap` resamples blocks.
"""

from livlab.optimise.bootstrap import BootstrapResult, block_weights, bootstrap
from livlab.optimise.covariance import Covariance, covariance, covariance_of_residuals
from livlab.optimise.driver import minimise
from livlab.optimise.identifiability import Identifiability, identifiability
from livlab.optimise.parameters import Parameter, ParameterSpace
from livlab.optimise.profile import Profile, profile
from livlab.optimise.residuals import least_squares
from livlab.optimise.result import FitWarning, OptimiseResult

__all__ = [
    "BootstrapResult",
    "Covariance",
    "FitWarning",
    "Identifiability",
    "OptimiseResult",
    "Parameter",
    "ParameterSpace",
    "Profile",
    "block_weights",
    "bootstrap",
    "covariance",
    "covariance_of_residuals",
    "identifiability",
    "least_squares",
    "minimise",
    "profile",
]
