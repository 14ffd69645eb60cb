"""Roulette for walks that take longer than anyone waits.

Walks without absorption last longer than n steps in proportion to n^(−1/2). With a survival of 2^(−1/2) each time
that n has doubled, each doubling costs as much time, and adds as much variance, as the one before; the mean stays.
"""

from __future__ import annotations

from typing import Any

FROM = 1 << 17
"""Steps after which a photon goes on by chance, and again each time that their number has doubled."""

SURVIVAL = 181 / 256
"""That chance; one that goes on weighs 1/`SURVIVAL` times as much."""


def play(dr: Any, steps: Any, bits: Any, weight: Any, walks: Any) -> tuple[Any, Any, Any]:
    """Of the photons that walk: which end here, what they weigh then, and what each gave or (negative) got.

    The draw is the lowest byte of random bits of which only the upper 24 serve otherwise.
    """
    late = (steps >= FROM) & ((steps & (steps - 1)) == 0) & walks

    def draw(late: Any, bits: Any, weight: Any) -> tuple[Any, Any, Any]:
        culled = late & ((bits & 0xFF) >= round(256 * SURVIVAL))
        heavier = dr.select(late & ~culled, weight * (1.0 / SURVIVAL), weight)
        return culled, heavier, dr.select(culled, weight, weight - heavier)

    def go_on(late: Any, bits: Any, weight: Any) -> tuple[Any, Any, Any]:
        return late, weight, 0.0 * weight

    found: tuple[Any, Any, Any] = dr.if_stmt((late, bits, weight), late, draw, go_on)
    return found


def heaviest(max_steps: int) -> float:
    """Weight that a photon given up after so many steps has at most.

    >>> heaviest(FROM), round(heaviest(4 * FROM), 6), round(heaviest(4 * FROM + 1), 6)
    (1.0, 2.000427, 2.829334)
    """
    doublings = max(0, (max(max_steps, 1) - 1).bit_length() - FROM.bit_length() + 1)
    return float(SURVIVAL**-doublings)
