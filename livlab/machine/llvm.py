"""Find a libLLVM that Dr.Jit can use, and keep a bad one from ending the process.

Dr.Jit takes the first libLLVM it meets. With LLVM 14 and older it switches its LLVM backend off; with 15 and 16 a
kernel that holds an `fmaximum` aborts the whole process ("Cannot select"). So each candidate is judged by its version,
and an allowed one has to run a small kernel in a process of its own before this process is pointed at it.

Dr.Jit loads the library while it is being imported: call `choose_libllvm` before the first ``import drjit``.
"""

from __future__ import annotations

import ctypes.util
import os
import platform
import re
import sys
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from livlab.errors import EnvironmentProblem
from livlab.machine.llvm_probe import VARIABLE, Verdict, probe

OLDEST_MAJOR = 17
THREADS = "LIVLAB_THREADS"
"""Environment variable: threads of the processor that Dr.Jit may use in this process; all cores if it is not set."""

TESTED_MAJORS = (19, 20, 18, 17)
"""The walk met its reference values with each of these; the first is preferred."""

_PATTERNS = {
    "Linux": (
        "/usr/lib/{machine}-linux-gnu/libLLVM*.so*",
        "/usr/lib/llvm-*/lib/libLLVM*.so*",
        "/usr/lib64/libLLVM*.so*",
        "/usr/lib64/llvm*/lib*/libLLVM*.so*",
        "/usr/lib/libLLVM*.so*",
        "/usr/local/lib/libLLVM*.so*",
        "/home/linuxbrew/.linuxbrew/opt/llvm*/lib/libLLVM*.so*",
    ),
    "Darwin": (
        "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
        "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
        "/opt/local/libexec/llvm-*/lib/libLLVM*.dylib",
    ),
}
_MAJOR = (
    re.compile(r"/libLLVM-(\d+)[.\d]*\.(?:so|dylib)"),
    re.compile(r"/llvm(?:@|-|/)(\d+)[.\d]*/"),
    re.compile(r"/libLLVM\.so\.(\d\d+)"),  # two digits: Ubuntu's /usr/lib/llvm-18/lib/libLLVM.so.1 is no LLVM 1
)


@dataclass(frozen=True)
class Libllvm:
    """One candidate: where it lies, who named it, what it is, and whether Dr.Jit may use it.

    Attributes
    ----------
    path
        The library, links resolved.
    origin
        The environment variable or the search that named it.
    major
        Major version, None where neither the name nor a probe tells.
    verdict
        "good" (a probe kernel ran), "refused", or "unknown" (nothing to probe with).
    reason
        Why, in one sentence.
    """

    path: Path
    origin: str
    major: int | None
    verdict: Verdict
    reason: str


_lock = threading.Lock()
_chosen: Path | None = None


def choose_libllvm() -> Path:
    """Point Dr.Jit at a libLLVM that works, before it is imported.

    A library named by the environment variable ``DRJIT_LIBLLVM_PATH`` is taken or refused, never replaced in silence.
    Otherwise LLVM 19 is preferred, then 20, 18 and 17, then newer ones. Safe to call often and from several threads.

    Returns
    -------
    Path
        The chosen library; ``DRJIT_LIBLLVM_PATH`` names it from now on.

    Raises
    ------
    EnvironmentProblem
        When there is none, when the one asked for is refused, or when Dr.Jit was imported before with a bad one.
    """
    global _chosen  # noqa: PLW0603
    with _lock:
        if _chosen is not None and os.environ.get(VARIABLE) == str(_chosen):
            return _chosen
        if "drjit" in sys.modules:
            path = _adopt_loaded()
        elif os.environ.get(VARIABLE):
            path = _demand_good(_judge(Path(os.environ[VARIABLE]), VARIABLE))
        else:
            path = _first_good()
        os.environ[VARIABLE] = str(path)
        _chosen = path
        return path


def inspect_libllvm() -> list[Libllvm]:
    """List every candidate with its verdict, in the order `choose_libllvm` would take them.

    Returns
    -------
    list of Libllvm
        Empty on a machine that has none. Never raises and never loads a library into this process.
    """
    with _lock:
        found = []
        named = os.environ.get(VARIABLE)
        if named:
            found.append(_judge(Path(named), VARIABLE))
        found += [_judge(path, origin) for path, origin in _search() if not named or path != _resolve(Path(named))]
        return found


def install_command() -> str:
    """Name the one command that brings a usable libLLVM to this machine."""
    if platform.system() == "Darwin":
        return "brew install llvm"
    likes = _distribution()
    if likes & {"debian", "ubuntu"}:  # Dr.Jit itself needs libatomic, which a minimal system lacks
        return "sudo apt-get install -y libatomic1 libllvm19"
    if likes & {"fedora", "rhel"}:
        return "sudo dnf install -y libatomic llvm-libs"
    if "arch" in likes:
        return "sudo pacman -S --needed llvm-libs"
    return f"install the shared library of LLVM {OLDEST_MAJOR} or newer and set {VARIABLE} to it"


def _distribution() -> set[str]:
    try:
        release = platform.freedesktop_os_release()
    except OSError:
        return set()
    return {release.get("ID", ""), *release.get("ID_LIKE", "").split()}


def _first_good() -> Path:
    refused = []
    for path, origin in _search():
        candidate = _judge(path, origin)
        if candidate.verdict == "good":
            return candidate.path
        if candidate.verdict == "unknown":
            raise _unusable(candidate)
        refused.append(f"{candidate.path} ({candidate.reason})")
    message = f"No usable libLLVM found (need {OLDEST_MAJOR} or newer)"
    message += f"; refused: {'; '.join(refused)}." if refused else "."
    raise EnvironmentProblem(message, remedy=f"Run `{install_command()}`.")


def _demand_good(candidate: Libllvm) -> Path:
    if candidate.verdict == "good":
        return candidate.path
    if candidate.verdict == "unknown":
        raise _unusable(candidate)
    other = next((found for found in (_judge(*place) for place in _search()) if found.verdict == "good"), None)
    remedy = f"Unset {VARIABLE}; livlab then takes {other.path}." if other else f"Run `{install_command()}`."
    raise EnvironmentProblem(f"{VARIABLE} names {candidate.path}: {candidate.reason}.", remedy=remedy)


def _unusable(candidate: Libllvm) -> EnvironmentProblem:
    """Dr.Jit itself is at fault: the library was never tried."""
    command = install_command() if "shared object" in candidate.reason else "make setup"
    return EnvironmentProblem(f"Dr.Jit cannot be used: {candidate.reason}.", remedy=f"Run `{command}`.")


def _adopt_loaded() -> Path:
    """Judge the library a Dr.Jit imported earlier has taken: by now nobody can change it."""
    loaded = _mapped()
    if loaded is None and os.environ.get(VARIABLE):
        loaded = Path(os.environ[VARIABLE])
    remedy = (
        f"Import livlab's model before drjit or mitsuba, or set {VARIABLE}; if there is none: `{install_command()}`."
    )
    if loaded is None:
        raise EnvironmentProblem("Dr.Jit was imported before and found no libLLVM.", remedy=remedy)
    candidate = _judge(loaded, "loaded by Dr.Jit")
    if candidate.verdict != "good":
        message = f"Dr.Jit was imported before and has loaded {candidate.path}: {candidate.reason}."
        raise EnvironmentProblem(message, remedy=remedy)
    return candidate.path


def _mapped() -> Path | None:
    """Path of the libLLVM in this process, where the system tells (Linux)."""
    try:
        lines = Path("/proc/self/maps").read_text().splitlines()
    except OSError:
        return None
    for line in lines:
        fields = line.split(maxsplit=5)
        if len(fields) == 6 and Path(fields[5]).name.startswith("libLLVM"):
            return Path(fields[5])
    return None


def _search() -> list[tuple[Path, str]]:
    """Collect the candidates, each once, best guess first."""
    found: dict[Path, str] = {}
    for path, origin in _places():
        resolved = _resolve(path)
        if os.path.isfile(resolved):  # noqa: PTH113 - Path.is_file raises where a folder may not be read
            found.setdefault(resolved, origin)
    return sorted(found.items(), key=lambda item: _rank(item[0]))


def _places() -> Iterator[tuple[Path, str]]:
    for pattern in _PATTERNS.get(platform.system(), ()):
        filled = pattern.format(machine=platform.machine())
        yield from ((path, filled) for path in _glob(filled))
    for path in _glob(f"{sys.prefix}/lib/libLLVM*"):
        yield path, "the Python environment"
    name = ctypes.util.find_library("LLVM")
    if name and Path(name).is_absolute():
        yield Path(name), "the system's library search"


def _glob(pattern: str) -> Iterable[Path]:
    try:
        return sorted(path for path in Path("/").glob(pattern.lstrip("/")) if re.search(r"\.(so|dylib)", path.name))
    except OSError:
        return []


def _rank(path: Path) -> tuple[int, int, str]:
    major = major_from_path(path)
    if major in TESTED_MAJORS:
        return (0, TESTED_MAJORS.index(major), str(path))
    if major is None:
        return (2, 0, str(path))
    return (1, major, str(path)) if major >= OLDEST_MAJOR else (3, -major, str(path))


def _resolve(path: Path) -> Path:
    try:
        return path.expanduser().resolve()
    except (OSError, RuntimeError):
        return path


def major_from_path(path: Path) -> int | None:
    """Read LLVM's major version from a library's name, or from the folder it lies in.

    >>> major_from_path(Path("/usr/lib/libLLVM-14.0.6.so.1")), major_from_path(Path("/usr/lib/libLLVM.so.19.1"))
    (14, 19)
    >>> major_from_path(Path("/opt/homebrew/Cellar/llvm/20.1.2/lib/libLLVM.dylib"))
    20
    >>> major_from_path(Path("/usr/lib/llvm-18/lib/libLLVM.so.1"))
    18
    >>> major_from_path(Path("/usr/lib/libLLVM.so")) is None
    True
    """
    matches = (pattern.search(str(path)) for pattern in _MAJOR)
    return next((int(match.group(1)) for match in matches if match), None)


def _judge(path: Path, origin: str) -> Libllvm:
    resolved = _resolve(path)
    if not os.path.isfile(resolved):  # noqa: PTH113
        return Libllvm(resolved, origin, None, "refused", "there is no such file, or it may not be read")
    major = major_from_path(resolved)
    if major is not None and major < OLDEST_MAJOR:
        return Libllvm(resolved, origin, major, "refused", _too_old(major))
    verdict, seen, reason = probe(resolved)
    major = seen or major
    if verdict == "good" and major is not None and major < OLDEST_MAJOR:
        return Libllvm(resolved, origin, major, "refused", _too_old(major))
    if verdict == "good" and major not in TESTED_MAJORS:
        reason += f"; livlab was tested with {', '.join(map(str, sorted(TESTED_MAJORS)))} only"
    return Libllvm(resolved, origin, major, verdict, reason)


def _too_old(major: int) -> str:
    why = "Dr.Jit refuses it" if major < 15 else "it aborts the process at a kernel that uses fmaximum"
    return f"LLVM {major} is too old: {why}"
