"""All runners by name: importing this module is what makes them known."""

from livlab.stress import (
    cases_energy,
    cases_scatterers,
    cases_solvers,
    cases_sums,
    cases_surfaces,
    cases_tissue,
    cases_transport,
)
from livlab.stress.measured import RUNNERS

__all__ = [
    "RUNNERS",
    "cases_energy",
    "cases_scatterers",
    "cases_solvers",
    "cases_sums",
    "cases_surfaces",
    "cases_tissue",
    "cases_transport",
]
