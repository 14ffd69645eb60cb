"""Reflectance from pictures of spheres: geometry, samples, tables, models and fits. Knows no renderer.

`extract`, `read`, `write`, `fit_model` and `plot` are the notebook's way in (`livlab.api.brdf`).
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from livlab.api.brdf import extract as extract
    from livlab.api.brdf import fit_model as fit_model
    from livlab.api.brdf import plot as plot
    from livlab.api.brdf import read as read
    from livlab.api.brdf import write as write

__all__ = ["extract", "fit_model", "plot", "read", "write"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'livlab.brdf' has no attribute {name!r}")
    return getattr(_import_module("livlab.api.brdf"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
