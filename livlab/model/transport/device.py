"""The door to Dr.Jit: which array types a variant uses, imported only when a walk is asked for."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from livlab.errors import EnvironmentProblem, InputError
from livlab.machine.llvm import THREADS, choose_libllvm

Variant = Literal["llvm", "cuda"]

LANES: dict[Variant, int] = {"llvm": 1 << 14, "cuda": 1 << 18}
"""Walkers in flight: enough for every core, few enough to stay in cache."""

BATCH_PHOTONS: dict[Variant, int] = {"llvm": 1 << 22, "cuda": 1 << 25}
"""Photons of a launch over all wavelengths: a second or so of work."""


@dataclass(frozen=True)
class Device:
    """Array types of one Dr.Jit backend; `dr` is the module itself.

    Typed as Any: Dr.Jit's overloads do not survive strict checking of traced code.
    """

    variant: Variant
    dr: Any
    Float: Any
    Float64: Any
    UInt32: Any
    UInt64: Any
    Int32: Any
    Int64: Any
    Bool: Any
    PCG32: Any

    @classmethod
    def of(cls, variant: Variant, dr: Any, types: Any) -> Device:
        """A backend's array types from the module that has them."""
        names = ("Float", "Float64", "UInt32", "UInt64", "Int32", "Int64", "Bool", "PCG32")
        return cls(variant, dr, **{name: getattr(types, name) for name in names})

    def load(self, kind: Any, values: Any) -> Any:
        """An array of Dr.Jit's own from numbers.

        Dr.Jit maps numpy's memory in place, and where that happens to lie decides the alignment written into
        the kernel, so that the next call would compile anew. Its own memory is always aligned.
        """
        return kind(np.asarray(values).ravel().tolist())


def device(variant: Variant) -> Device:
    """Load Dr.Jit for a variant.

    Raises
    ------
    InputError
        If the variant is unknown.
    EnvironmentProblem
        If "llvm" finds no usable libLLVM or "cuda" no GPU.
    """
    if variant not in LANES:
        raise InputError.of("variant", variant, "must be 'llvm' or 'cuda'", "Name one of the two.")
    if variant == "llvm":
        choose_libllvm()
        import drjit as dr
        import drjit.llvm as llvm_types

        backend: Any = llvm_types
    else:
        with suppress(EnvironmentProblem):  # a machine with a GPU may do without
            choose_libllvm()
        import drjit as dr
        import drjit.cuda as cuda_types

        backend = cuda_types
        if not dr.has_backend(dr.JitBackend.CUDA):
            raise EnvironmentProblem("variant 'cuda' finds no GPU or no driver.", remedy="Use variant 'llvm'.")
    limit_threads(dr)
    return Device.of(variant, dr, backend)


def limit_threads(dr: Any) -> None:
    """Keep Dr.Jit to as many threads as the environment variable ``LIVLAB_THREADS`` says, where it is set.

    Several processes on one machine would else each take every core. The numbers do not depend on it.

    Raises
    ------
    EnvironmentProblem
        The variable holds no positive number.
    """
    wanted = os.environ.get(THREADS, "")
    if not wanted:
        return
    if not wanted.isdecimal() or not 1 <= int(wanted) <= 4096:
        raise EnvironmentProblem(
            f"{THREADS} = {wanted!r} is no number of threads.", remedy=f"Set 1 or more, or unset {THREADS}."
        )
    if dr.thread_count() != int(wanted):
        dr.set_thread_count(int(wanted))
