"""livlab: the lab that says how light and living tissue meet, and proves it.

>>> import livlab
>>> livlab.tissue("liver", variant="parenchyma_only")
<Tissue human liver, parenchyma only, ex_vivo: parenchyma 140 mm>
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from livlab import brdf as brdf
    from livlab import criteria as criteria
    from livlab import datasets as datasets
    from livlab import errors as errors
    from livlab import metrics as metrics
    from livlab.api.claims import Claims as Claims
    from livlab.api.compare import Comparison as Comparison
    from livlab.api.compare import compare as compare
    from livlab.api.curve import Spectrum as Spectrum
    from livlab.api.fit_result import FitResult as FitResult
    from livlab.api.fitting import fit as fit
    from livlab.api.running import RunResult as RunResult
    from livlab.api.running import open_run as open_run
    from livlab.api.running import rerun as rerun
    from livlab.api.running import run as run
    from livlab.api.simulate import spectrum as spectrum
    from livlab.api.simulate import tissue as tissue
    from livlab.api.sources import read_spectrum as read_spectrum
    from livlab.api.sources import reference as reference
    from livlab.machine.version import __version__ as __version__
    from livlab.model.tissue.readings import Reading as Reading

# Imported when first asked for, so that `import livlab` costs nothing.
_LAZY = {
    **dict.fromkeys(("brdf", "criteria", "datasets", "errors", "metrics"), ""),
    "Claims": "livlab.api.claims",
    **dict.fromkeys(("Comparison", "compare"), "livlab.api.compare"),
    "Spectrum": "livlab.api.curve",
    **dict.fromkeys(("read_spectrum", "reference"), "livlab.api.sources"),
    "FitResult": "livlab.api.fit_result",
    "fit": "livlab.api.fitting",
    **dict.fromkeys(("RunResult", "open_run", "rerun", "run"), "livlab.api.running"),
    **dict.fromkeys(("spectrum", "tissue"), "livlab.api.simulate"),
    "Reading": "livlab.model.tissue.readings",
    "__version__": "livlab.machine.version",
}

__all__ = [
    "Claims",
    "Comparison",
    "FitResult",
    "Reading",
    "RunResult",
    "Spectrum",
    "__version__",
    "brdf",
    "compare",
    "criteria",
    "datasets",
    "errors",
    "fit",
    "metrics",
    "open_run",
    "read_spectrum",
    "reference",
    "rerun",
    "run",
    "spectrum",
    "tissue",
]


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module 'livlab' has no attribute {name!r}")
    home = _LAZY[name]
    found = getattr(_import_module(home), name) if home else _import_module(f"livlab.{name}")
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
