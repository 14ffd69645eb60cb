"""Run every benchmark, each in a process of its own: `python -m benchmarks [NAME…]`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def main() -> int:
    """Run the named benchmarks, all by default; return how many failed."""
    here = Path(__file__).parent
    every = sorted(f.stem.removeprefix("bench_") for f in here.glob("bench_*.py"))
    wanted = sys.argv[1:] or every
    unknown = sorted(set(wanted) - set(every))
    if unknown:
        print(f"unknown: {', '.join(unknown)}. There are: {', '.join(every)}.", file=sys.stderr)
        return 2
    failed = 0
    for name in wanted:
        print(f"\n## {name}", flush=True)
        failed += subprocess.run([sys.executable, "-m", f"benchmarks.bench_{name}"], check=False).returncode != 0
    return failed


if __name__ == "__main__":
    sys.exit(main())
