"""Names in what a run keeps: `reflectance` is what the instrument reads there, and nothing else.

A solver calls all light that leaves the lit side its `reflectance`; in a run's files that is `diffuse_reflectance`.
"""

import xarray as xr

DIFFUSE = {f"reflectance{end}": f"diffuse_reflectance{end}" for end in ("", "_se", "_systematic")}
"""By a solver's name, the name in files."""


def as_kept(solved: xr.Dataset) -> xr.Dataset:
    """A solver's answer under the names of files.

    >>> list(as_kept(xr.Dataset({"value": 0.3, "reflectance": 0.4})))
    ['value', 'diffuse_reflectance']
    """
    return solved.rename({solver: kept for solver, kept in DIFFUSE.items() if solver in solved})


def as_solved(kept: xr.Dataset) -> xr.Dataset:
    """What was kept, under a solver's names, so that the solver can go on from it."""
    return kept.rename({name: solver for solver, name in DIFFUSE.items() if name in kept})
