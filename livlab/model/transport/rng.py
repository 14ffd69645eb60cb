"""Random streams of the walk: PCG32, one a lane, each started by a hash of its number.

PCG32 streams that differ only in their sequence number are not independent enough: consecutive numbers with
one common start left the reflectance of a slab two to three standard errors off. Both the state and the
increment are therefore drawn from the lane's number through the Tiny Encryption Algorithm (Wheeler & Needham
1994; as a GPU hash: Zafar, Olano & Curtis 2010), keyed by a hash of seed and batch.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from livlab.errors import InputError
from livlab.model.transport.device import Device

TEA_ROUNDS = 8
_DELTA = 0x9E3779B9
_KEY = (0xA341316C, 0xC8013EA4, 0xAD90777D, 0x7E95761E)


def tea(v0: Any, v1: Any, word: Any, rounds: int = TEA_ROUNDS) -> tuple[Any, Any]:
    """Hash two 32-bit words into two others; a bijection, so distinct inputs stay distinct.

    Parameters
    ----------
    v0, v1
        Unsigned 32-bit words, scalars or arrays of any type that wraps around.
    word
        That type, called on Python's own constants.
    """
    k0, k1, k2, k3 = (word(k) for k in _KEY)
    total = 0
    for _ in range(rounds):
        total = (total + _DELTA) & 0xFFFFFFFF
        s = word(total)
        v0 = v0 + (((v1 << 4) + k0) ^ (v1 + s) ^ ((v1 >> 5) + k1))
        v1 = v1 + (((v0 << 4) + k2) ^ (v0 + s) ^ ((v0 >> 5) + k3))
    return v0, v1


def words(seed: int, batch: int) -> tuple[int, int, int, int]:
    """Four 32-bit words that key a batch: consecutive seeds and batches have nothing in common.

    Raises
    ------
    InputError
        If the seed is negative.
    """
    if seed < 0:
        raise InputError.of("seed", seed, "must be >= 0", "Give a natural number.")
    w = np.random.SeedSequence([seed, batch]).generate_state(4, np.uint32)
    return int(w[0]), int(w[1]), int(w[2]), int(w[3])


def streams(d: Device, lanes: int, seed: int, batch: int) -> Any:
    """(lanes,) PCG32 generators; the numbers are opaque, so another seed uses the same kernel."""
    w = [d.dr.opaque(d.UInt32, x) for x in words(seed, batch)]
    lane = d.dr.arange(d.UInt32, lanes)
    s0, s1 = tea(lane ^ w[0], w[1], d.UInt32)
    i0, i1 = tea(lane ^ w[2], w[3], d.UInt32)
    rng = d.PCG32()
    rng.state = (d.UInt64(s0) << 32) | d.UInt64(s1)
    rng.inc = (((d.UInt64(i0) << 32) | d.UInt64(i1)) << 1) | d.UInt64(1)
    return rng


def uniform(d: Device, bits: Any) -> Any:
    """U in [0, 1) from the upper 24 bits: both u and 1 − u are exact in single precision."""
    return d.Float(bits >> 8) * d.Float(2.0**-24)


def fine_uniform(d: Device, bits: Any) -> Any:
    """U in [0, 1) from all 32 bits: a probability far below 2^−24 keeps its digits, 1 is never reached."""
    return d.dr.minimum(d.Float(bits) * d.Float(2.0**-32), 1.0 - 2.0**-24)


def exponential(d: Device, bits: Any) -> Any:
    """−ln(1 − u) with u in [0, 1) of 32 bits: finite, and above 0 so that a rate of 0 never interacts.

    Below u = 1/64 by its series: 1 − u in single precision knows u to 6e-8 only, and an element whose rate is
    a millionth of its neighbours' wins by draws as short as that.
    """
    dr = d.dr
    tail = (d.Float(bits) + 1.0) * d.Float(2.0**-32)
    u = d.Float(~bits) * d.Float(2.0**-32)
    series = u * dr.fma(u, dr.fma(u, dr.fma(u, 0.25, 1.0 / 3.0), 0.5), 1.0)
    return dr.maximum(dr.select(u < 2.0**-6, series, -dr.log(tail)), 1e-30)
