"""Seeds of a run's parts, which follow from the experiment's."""

import hashlib


def reading_seed(seed: int, reading: str) -> int:
    """Seed of a reading's walk: independent between readings, and the same whatever other readings there are.

    >>> reading_seed(1, "thesis") != reading_seed(1, "measured")
    True
    """
    return int.from_bytes(hashlib.sha256(f"{seed}:{reading}".encode()).digest()[:4], "big") >> 1
