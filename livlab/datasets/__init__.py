"""The catalogue of measured and published numbers: load by name, hash checked, interpolate inside the range, cite.

>>> from livlab.datasets import load
>>> float(load("haemoglobin_prahl").interpolate("hbo2", 542.0)) > 50_000
True
"""

from livlab.datasets.catalogue import (
    Check,
    ReferenceUnavailable,
    builtin_root,
    check,
    check_all,
    load,
    names,
    unavailable,
    user_root,
)
from livlab.datasets.dataset import Dataset
from livlab.datasets.meta import ColumnMeta, DatasetMeta, Unavailable, Uncertainty

__all__ = [
    "Check",
    "ColumnMeta",
    "Dataset",
    "DatasetMeta",
    "ReferenceUnavailable",
    "Unavailable",
    "Uncertainty",
    "builtin_root",
    "check",
    "check_all",
    "load",
    "names",
    "unavailable",
    "user_root",
]
