"""Fuzz readers by coverage: `python -m fuzz [TARGET…] [--inputs N] [--keep DIR] [--seed N]`."""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from fuzz.targets import LONGEST, TARGETS, WAIT

_DONE = re.compile(r"^#(\d+)\s", re.MULTILINE)


def main() -> int:
    """Fuzz the named targets, all by default, each in a process of its own; return how many had a finding."""
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"of {', '.join(TARGETS)}; all if none")
    parser.add_argument(
        "--inputs", type=int, default=20_000, help="inputs to a cheap reader; a tenth or a hundredth to a dear one"
    )
    parser.add_argument("--seed", type=int, default=1, help="of the mutations")
    parser.add_argument("--keep", type=Path, help="folder for corpora and findings; one that goes away if not said")
    said = parser.parse_args()
    unknown = sorted(set(said.targets) - set(TARGETS))
    if unknown:
        print(f"unknown: {', '.join(unknown)}. There are: {', '.join(TARGETS)}.", file=sys.stderr)
        return 2
    found = 0
    with tempfile.TemporaryDirectory() as scratch:
        base = said.keep or Path(scratch)
        for name in said.targets or TARGETS:
            found += _one(name, max(1, said.inputs // TARGETS[name].cost), said.seed, base / name)
    return min(found, 125)


def _one(name: str, inputs: int, seed: int, place: Path) -> bool:
    (place / "corpus").mkdir(parents=True, exist_ok=True)
    (place / "findings").mkdir(exist_ok=True)
    command = [
        sys.executable, "-m", "fuzz.one", name, str(place), f"-runs={inputs}", f"-max_len={LONGEST}", f"-seed={seed}",
        f"-timeout={2 * WAIT}", "-rss_limit_mb=0", f"-artifact_prefix={place / 'findings'}/", "-print_final_stats=1",
        "-len_control=0", str(place / "corpus"),
    ]  # fmt: skip
    # In a process of their own: what makes them is compiled, and must not be changed to count branches.
    subprocess.run([sys.executable, "-m", "fuzz.seeds", name, str(place)], check=True, stdout=subprocess.DEVNULL)
    started = time.monotonic()
    with (place / "log").open("w", encoding="utf-8") as log:
        done = subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, check=False)
    text = (place / "log").read_text(encoding="utf-8", errors="replace")
    count = max((int(x) for x in _DONE.findall(text)), default=0)
    # Threads of Dr.Jit may end a process that is done already with a signal: that is none of the reader's.
    sound = done.returncode == 0 or f"Done {inputs} runs" in text
    verdict = "ok" if sound else f"FINDING, see {place / 'log'}"
    print(f"{name:18} {count:7d} inputs {time.monotonic() - started:7.1f} s  {verdict}", flush=True)
    if not sound:
        shown = [x[:400] for x in text.splitlines() if not x.startswith(("#", "0x", "stat::", "MS:"))]
        print("\n".join(shown[-40:]), file=sys.stderr)
    return not sound


if __name__ == "__main__":
    sys.exit(main())
