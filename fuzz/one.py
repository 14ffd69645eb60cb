"""One target in this process: `python -m fuzz.one TARGET PLACE [options of libFuzzer]`."""

from __future__ import annotations

import contextlib
import faulthandler
import logging
import os
import sys
import warnings
from pathlib import Path

COMPILED = [
    "livlab.brdf.models.coating",
    "livlab.brdf.models.kernels",
    "livlab.model.shapes.transform",
    "livlab.model.tissue.particles.cylinder_kernels",
    "livlab.model.tissue.particles.sphere_kernels",
    "livlab.model.tissue.phase.moments",
    "livlab.model.transport.ledger.kernel",
]
"""Numba compiles these, and knows nothing of what counts branches."""


STUCK = 120
"""Seconds after which nothing but C code can be to blame: a reader in Python is interrupted long before."""


def main() -> None:
    """Hand inputs, from the seeds on, to the reader until their number is reached or something is found."""
    import atheris

    name, place = sys.argv[1], Path(sys.argv[2])
    from fuzz.targets import TARGETS, attempt, bounded

    target = TARGETS[name]
    with atheris.instrument_imports(include=["livlab", *target.traced], exclude=COMPILED):
        for module in target.traced:
            __import__(module)
        start = (place / "corpus" / "seed-0").read_bytes()
        attempt(target, start, place / "attempt", place / "seed" / "folder")  # what is imported on use, is now
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)

    def once(content: bytes) -> None:
        # A library that loops in C lets no signal through to Python; a thread of its own ends the process then, and
        # the input is what lies in the folder `attempt`.
        faulthandler.dump_traceback_later(STUCK, exit=True)
        attempt(target, content, place / "attempt", place / "seed" / "folder")
        faulthandler.cancel_dump_traceback_later()

    atheris.Setup([sys.argv[0], *sys.argv[3:]], once)
    with bounded(), contextlib.redirect_stdout(open(os.devnull, "w")):  # noqa: PTH123
        atheris.Fuzz()


if __name__ == "__main__":
    main()
