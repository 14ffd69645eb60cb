"""Run a small kernel with a given libLLVM in a process of its own, and remember what happened.

Internal to `livlab.machine.llvm`. A verdict is kept in the user's cache folder, by the library's path, time and size,
by Dr.Jit's version and by the kernel's text, so that the next process need not ask again.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Literal

import platformdirs

VARIABLE = "DRJIT_LIBLLVM_PATH"
PROBE_SECONDS = 60.0

Verdict = Literal["good", "refused", "unknown"]
Outcome = tuple[Verdict, int | None, str]

# A random number generator, a loop, gather and scatter, and the instruction that LLVM 15 and 16 cannot select: what the
# transport kernels are made of. The answer is compared with one that no LLVM had a hand in.
_PROBE = """
import sys
try:
    import drjit as dr
    from drjit.llvm import Float, UInt32
except Exception as error:
    while error.__cause__ or error.__context__:  # the first of a chain names the library that is missing
        error = error.__cause__ or error.__context__
    print(f"{type(error).__name__}: {error}", file=sys.stderr)
    sys.exit(90)
n = 37
x = dr.arange(Float, n)
y = dr.minimum(dr.maximum(x, dr.opaque(Float, 5.25)), dr.opaque(Float, 20.5))
index, total = UInt32(0), Float(0)
index, total = dr.while_loop((index, total), lambda i, t: i < 4, lambda i, t: (i + 1, t + dr.maximum(y, Float(i))))
bins = dr.zeros(Float, 4)
dr.scatter_add(bins, total, dr.arange(UInt32, n) % 4)
got = sum(dr.gather(Float, bins, UInt32(0, 1, 2, 3)))
want = sum(4 * min(max(float(i), 5.25), 20.5) for i in range(n))
root = dr.sum(dr.exp(dr.log(dr.sqrt(dr.opaque(Float, 2.0))) * 2))[0]
if abs(got - want) > 1e-3 or abs(root - 2) > 1e-5:
    print(f"the probe kernel computed {got} and {root} instead of {want} and 2", file=sys.stderr)
    sys.exit(91)
print("probed", *dr.detail.llvm_version())
"""

_probed: dict[str, Outcome] = {}


def probe(path: Path) -> Outcome:
    """Run a small kernel with this library in another process, once per file and Dr.Jit version.

    Returns
    -------
    verdict
        "good", "refused", or "unknown" where Dr.Jit itself is missing or cannot be imported.
    major
        LLVM's major version as Dr.Jit sees it, or None.
    reason
        What happened, in one sentence.
    """
    try:
        drjit = version("drjit")
        stat = path.stat()
    except PackageNotFoundError:
        return "unknown", None, "the package drjit is not installed"
    except OSError as error:
        return "refused", None, f"it cannot be read ({error.strerror})"
    key = json.dumps([str(path), stat.st_mtime_ns, stat.st_size, drjit, hashlib.sha256(_PROBE.encode()).hexdigest()])
    if key not in _probed:
        verdict = _recall(key)
        if verdict is None:
            verdict, final = _run_probe(path)
            if final:
                _remember(key, verdict)
        _probed[key] = verdict
    return _probed[key]


def _run_probe(path: Path) -> tuple[Outcome, bool]:
    """Verdict of a fresh probe, and whether it would be the same another day."""
    environment = {**os.environ, VARIABLE: str(path)}
    # Dr.Jit keeps compiled kernels below the home folder, and one from a good LLVM would hide a bad one.
    environment.pop("HOME", None)
    environment.pop("DRJIT_CACHE_DIR", None)
    command = [sys.executable or "python3", "-P", "-c", _PROBE]
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=PROBE_SECONDS, check=False
        )
    except subprocess.TimeoutExpired:
        return ("refused", None, f"the probe kernel did not end within {PROBE_SECONDS:.0f} s"), False
    except OSError as error:
        return ("unknown", None, f"the probe could not be started ({error.strerror})"), False
    lines = [line for line in done.stderr.splitlines() if line.strip() and not line.startswith("jit_init():")]
    last = lines[-1].strip()[:200] if lines else "it said nothing"
    if done.returncode == 0 and done.stdout.startswith("probed"):
        numbers = done.stdout.split()[1:]
        return ("good", int(numbers[0]), f"LLVM {'.'.join(numbers)} ran the probe kernel"), True
    if done.returncode == 90:
        return ("unknown", None, f"importing drjit failed: {last}"), False
    if done.returncode < 0:
        error_line = next((line for line in lines if "LLVM ERROR" in line), last)[:200]
        return ("refused", None, f"the probe kernel ended its process by signal {-done.returncode}: {error_line}"), True
    return ("refused", None, f"the probe kernel failed: {last}"), done.returncode == 91


def _cache_file(key: str) -> Path | None:
    folder = Path(platformdirs.user_cache_dir("livlab"))
    if not folder.is_absolute():  # no home to speak of
        return None
    return folder / "libllvm" / f"{hashlib.sha256(key.encode()).hexdigest()[:24]}.json"


@dataclass(frozen=True)
class _Record:
    key: str
    verdict: Verdict
    major: int | None
    reason: str


def _recall(key: str) -> Outcome | None:
    file = _cache_file(key)
    if file is None:
        return None
    try:
        record = _Record(**json.loads(file.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None
    if record.key != key or record.verdict not in ("good", "refused"):
        return None
    return record.verdict, record.major, record.reason


def _remember(key: str, verdict: Outcome) -> None:
    """Write the verdict in one move; a cache that cannot be written only costs the next process a probe."""
    file = _cache_file(key)
    if file is None:
        return
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=file.parent, encoding="utf-8", delete=False) as handle:
            json.dump(asdict(_Record(key, *verdict)), handle)
        Path(handle.name).replace(file)
    except OSError:
        return
