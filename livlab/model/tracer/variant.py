"""The door to Mitsuba: a usable libLLVM first, then the module with a variant set."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from livlab.errors import EnvironmentProblem
from livlab.machine.llvm import choose_libllvm
from livlab.model.transport.device import limit_threads

DEFAULT_VARIANT = "llvm_ad_mono"


def mitsuba(variant: str | None = None) -> Any:
    """The mitsuba module with a variant set, typed as Any: its names exist only once a variant is set.

    Parameters
    ----------
    variant
        Mitsuba's name of a variant ("llvm_ad_mono", "llvm_ad_rgb", "cuda_ad_mono", "scalar_rgb"); None keeps the one
        that is set, or sets `DEFAULT_VARIANT`.

    Raises
    ------
    EnvironmentProblem
        Mitsuba is missing or lacks the variant, an llvm variant finds no usable libLLVM, or a cuda variant no GPU.
    """
    wanted = variant or DEFAULT_VARIANT
    if wanted.startswith("llvm"):
        choose_libllvm()
    else:
        with suppress(EnvironmentProblem):  # Dr.Jit looks for one at import, whatever the variant
            choose_libllvm()
    try:
        import mitsuba as mi
    except ImportError as error:
        raise EnvironmentProblem(f"Mitsuba cannot be imported: {error}.", remedy="Run `make setup`.") from error
    if wanted not in mi.variants():
        raise EnvironmentProblem(
            f"Mitsuba {mi.__version__} has no variant {wanted!r}.", remedy=f"Name one of: {', '.join(mi.variants())}."
        )
    if wanted.startswith("cuda"):
        import drjit as dr

        if not dr.has_backend(dr.JitBackend.CUDA):
            raise EnvironmentProblem(f"Variant {wanted!r} finds no GPU or no driver.", remedy="Use an llvm variant.")
    if (variant is not None or mi.variant() is None) and mi.variant() != wanted:
        mi.set_variant(wanted)
    if not str(mi.variant()).startswith("scalar"):
        import drjit as dr

        limit_threads(dr)
    return mi
