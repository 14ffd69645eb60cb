"""Look at the machine as livlab will use it, and say what stands in the way and how to mend it.

Nothing here imports Dr.Jit, Mitsuba or any other heavy package: a broken one is a finding, not a traceback. What has to
run to be believed runs in a process of its own.
"""

from __future__ import annotations

import ctypes.util
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Literal

from livlab.machine import gpu
from livlab.machine.llvm import Libllvm, inspect_libllvm, install_command
from livlab.machine.llvm_probe import VARIABLE

State = Literal["ok", "note", "warning", "blocked"]

OLDEST_PYTHON = (3, 11)
ENOUGH_MEMORY_GIB = 4.0
ENOUGH_DISK_GIB = 1.0
VARIANT_SECONDS = 60.0
LLVM_VARIANTS = ("llvm_ad_mono", "llvm_ad_spectral")
CUDA_VARIANTS = ("cuda_ad_mono", "cuda_ad_spectral")

_GIB = 2.0**30
_SET_UP = "Run `make setup` (or `pip install -c constraints.txt livlab`)."

# One line per variant, flushed at once: when a variant ends the process, those before it have been heard.
_VARIANTS = """
import sys
import mitsuba as mi
for name in sys.argv[1:]:
    mi.set_variant(name)
    import drjit as dr
    total = dr.sum(mi.Float(1.0) + dr.arange(mi.Float, 5))[0]
    kept = mi.load_dict({"type": "sphere"}).bbox().max[0]
    print("ran" if total == 15 and kept == 1 else "computed-wrong", name, flush=True)
"""


@dataclass(frozen=True)
class Finding:
    """One thing looked at.

    Attributes
    ----------
    topic
        What was looked at.
    state
        "ok"; "note" (worth knowing); "warning" (something is slower or missing); "blocked" (the main job will fail).
    detail
        What was found.
    remedy
        What mends it; empty where nothing needs mending.
    """

    topic: str
    state: State
    detail: str
    remedy: str = ""


def examine() -> list[Finding]:
    """Look at everything.

    Returns
    -------
    list of Finding
        In the order of what depends on what: Python, packages, libLLVM, variants, GPU, machine.
    """
    checks: Sequence[Callable[[], list[Finding]]] = (
        python_findings,
        package_findings,
        llvm_findings,
        cuda_findings,
        machine_findings,
        cache_findings,
    )
    return [finding for check in checks for finding in check()]


def blocked(findings: Sequence[Finding]) -> bool:
    """Say whether any finding keeps the main job from running."""
    return any(finding.state == "blocked" for finding in findings)


def python_findings() -> list[Finding]:
    """Version and place of the interpreter."""
    detail = f"{platform.python_version()} ({platform.system()} {platform.machine()}) at {sys.executable}"
    if sys.version_info[:2] < OLDEST_PYTHON:
        return [Finding("Python", "blocked", detail, "Install Python 3.11 or newer and set livlab up with it.")]
    return [Finding("Python", "ok", detail)]


def package_findings(constraints: Path | None = None) -> list[Finding]:
    """Hold the installed packages against what livlab requires and against the versions it was tested with.

    Parameters
    ----------
    constraints
        File of ``name==version`` lines; by default the one livlab came with.
    """
    tested = _read_constraints(constraints or _constraints_file())
    missing, present = [], []
    for name in _required():
        try:
            present.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            missing.append(name)
    findings = [Finding("packages", "ok", ", ".join(present))]
    if missing:
        findings.append(Finding("packages", "blocked", f"not installed: {', '.join(missing)}", _SET_UP))
    differing = []
    for name, pinned in tested.items():
        try:
            installed = version(name)
        except PackageNotFoundError:
            continue
        if installed != pinned:
            differing.append(f"{name} {installed} (tested: {pinned})")
    if differing:
        findings.append(Finding("packages", "warning", f"other versions than tested: {', '.join(differing)}", _SET_UP))
    elif tested:
        findings.append(Finding("packages", "ok", f"all as tested ({len(tested)} pinned versions)"))
    else:
        findings.append(Finding("packages", "note", "no constraints.txt to compare the versions with"))
    return findings


def llvm_findings() -> list[Finding]:
    """List each libLLVM with its verdict, say which one Dr.Jit will get, and run the variants with it."""
    candidates = inspect_libllvm()
    chosen = next((found for found in candidates if found.verdict == "good"), None)
    if candidates and candidates[0].origin == VARIABLE and candidates[0].verdict != "good":
        chosen = None  # a library asked for by name is taken or refused, never replaced
    findings = [_describe(found, found is chosen) for found in candidates]
    if chosen is None:
        findings.append(Finding("libLLVM", "blocked", "none that Dr.Jit can use", _llvm_remedy(candidates)))
        return findings
    return findings + variant_findings(LLVM_VARIANTS, {VARIABLE: str(chosen.path)}, "blocked")


def _describe(found: Libllvm, is_chosen: bool) -> Finding:
    verdict = "chosen" if is_chosen else {"good": "usable"}.get(found.verdict, found.verdict)
    return Finding(
        "libLLVM",
        "ok" if found.verdict == "good" else "note",
        f"{verdict}: {found.path}: {found.reason} [{found.origin}]",
    )


def _llvm_remedy(candidates: Sequence[Libllvm]) -> str:
    unknown = next((found for found in candidates if found.verdict == "unknown"), None)
    if unknown is not None and "shared object" not in unknown.reason:
        return _SET_UP
    if candidates and candidates[0].origin == VARIABLE and any(found.verdict == "good" for found in candidates):
        return f"Unset {VARIABLE}."
    return f"Run `{install_command()}`."


def variant_findings(names: Sequence[str], extra: dict[str, str], state_of_failure: State) -> list[Finding]:
    """Start Mitsuba in another process and let each variant compute something.

    Parameters
    ----------
    names
        Variants to try, in order.
    extra
        Environment variables added for that process.
    state_of_failure
        What a variant that does not run amounts to.
    """
    command = [sys.executable, "-P", "-c", _VARIANTS, *names]
    environment = {**os.environ, **extra}
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=VARIANT_SECONDS, check=False
        )
        output, lines = done.stdout, [line.strip() for line in done.stderr.splitlines() if line.strip()]
        how = f"signal {-done.returncode}" if done.returncode < 0 else f"exit status {done.returncode}"
        why = f"{how}: {lines[-1][:200]}" if lines else how
    except subprocess.TimeoutExpired as late:
        output = late.stdout.decode() if isinstance(late.stdout, bytes) else late.stdout or ""
        why = f"no answer within {VARIANT_SECONDS:.0f} s"
    except OSError as error:
        output, why = "", f"could not be started ({error.strerror})"
    ran = {line.split()[1] for line in output.splitlines() if line.startswith("ran ")}
    good, bad = [name for name in names if name in ran], [name for name in names if name not in ran]
    findings = []
    if good:
        findings.append(Finding("variants", "ok", f"{', '.join(good)} run"))
    if bad:
        findings.append(Finding("variants", state_of_failure, f"{', '.join(bad)} do not run ({why})", _SET_UP))
    return findings


def cuda_findings() -> list[Finding]:
    """Name the GPUs and, where there are any, run the CUDA variants."""
    smi = shutil.which("nvidia-smi")
    if smi is None and ctypes.util.find_library("cuda") is None:
        return [Finding("GPU", "note", "no NVIDIA GPU found: everything runs on the processor")]
    names = "; ".join(gpu.names())
    if not names and smi:
        return [
            Finding("GPU", "warning", "nvidia-smi lists no GPU", "Check the NVIDIA driver; the processor serves too.")
        ]
    found = names or "a CUDA driver without nvidia-smi (`pip install 'livlab[gpu]'` names the GPU)"
    return [Finding("GPU", "ok", found), *variant_findings(CUDA_VARIANTS, {}, "warning")]


def machine_findings(folder: Path | None = None) -> list[Finding]:
    """Cores, memory, and the disk that run folders go to.

    Parameters
    ----------
    folder
        Where runs are kept; by default the current folder.
    """
    import psutil

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    findings = [Finding("cores", "ok", f"{cores} usable of {os.cpu_count()}")]
    memory = psutil.virtual_memory()
    detail = f"{memory.available / _GIB:.1f} GiB free of {memory.total / _GIB:.1f} GiB"
    if memory.available < ENOUGH_MEMORY_GIB * _GIB:
        findings.append(Finding("memory", "warning", detail, "Close something, or ask for fewer samples at a time."))
    else:
        findings.append(Finding("memory", "ok", detail))
    place = folder or Path.cwd()
    free = shutil.disk_usage(place).free
    detail = f"{free / _GIB:.1f} GiB free at {place}"
    if free < ENOUGH_DISK_GIB * _GIB:
        findings.append(Finding("disk", "warning", detail, "Make room, or run in another folder."))
    else:
        findings.append(Finding("disk", "ok", detail))
    if not _can_write(place):
        findings.append(Finding("disk", "warning", f"{place} is read-only", "Run in a folder you may write to."))
    return findings


def cache_findings() -> list[Finding]:
    """Say whether Dr.Jit can keep its compiled kernels; without, each process compiles them anew."""
    named, home = os.environ.get("DRJIT_CACHE_DIR"), os.environ.get("HOME")
    if not named and not home:
        return [
            Finding("kernel cache", "warning", "HOME is not set", "Set HOME or DRJIT_CACHE_DIR to a writable folder.")
        ]
    folder = (Path(named) if named else Path(str(home)) / ".drjit").absolute()
    nearest = next(place for place in (folder, *folder.parents) if os.path.lexists(place))
    if _can_write(nearest):
        return [Finding("kernel cache", "ok", str(folder))]
    return [
        Finding("kernel cache", "warning", f"{folder} cannot be written", "Set DRJIT_CACHE_DIR to a writable folder.")
    ]


def _can_write(folder: Path) -> bool:
    """Try it: root is told "yes" by the permission bits even where no file can be made."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _required() -> list[str]:
    """Names of the packages livlab cannot do without, as its own metadata has them."""
    try:
        lines = requires("livlab") or []
    except PackageNotFoundError:
        return []
    names = [re.split(r"[\s<>=!~;\[(]", line, maxsplit=1)[0] for line in lines if "extra ==" not in line]
    return sorted(names)


def _constraints_file() -> Path | None:
    package = Path(__file__).resolve().parents[1]
    for candidate in (package / "_data" / "constraints.txt", package.parent / "constraints.txt"):
        if candidate.is_file():
            return candidate
    return None


def _read_constraints(path: Path | None) -> dict[str, str]:
    if path is None:
        return {}
    lines = (line.split("#", 1)[0].strip() for line in path.read_text(encoding="utf-8").splitlines())
    return dict(line.split("==", 1) for line in lines if "==" in line)
