"""Run folders: from a resolved experiment to a folder that says what came out, from what, and how to get it again.

A folder is named by the experiment and the digest of everything that decides its numbers, so the same experiment
finds its result, and a changed one makes a new folder. Work is kept in pieces: a run that was stopped goes on.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import platform
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType
from typing import Any

from livlab import __version__
from livlab.config import KINDS, Experiment, to_toml
from livlab.core.files import readable
from livlab.errors import EnvironmentProblem, Interrupted
from livlab.machine.origin import code, processor
from livlab.runs.compare import timeless_hashes
from livlab.runs.files import locked, open_folder, plain_file, read_csv, sha256, write_whole
from livlab.runs.work import Progress, Run, Silent

LARGEST_MANIFEST = 1 << 26
"""Bytes; a study of many jobs writes some MiB."""

RESULT_VERSION = 3
"""Raised whenever the same experiment would give other numbers than before; it is part of the digest."""

_PACKAGES = ("numpy", "scipy", "xarray", "pandas", "pydantic", "miepython", "numba", "drjit", "mitsuba")


@dataclass(frozen=True)
class Outcome:
    """Where a run ended.

    Attributes
    ----------
    folder, report
        The run folder and its report (None where the report could not be made).
    claims
        Rows of claims.csv, as text.
    cached
        Whether the result was there before.
    """

    folder: Path
    report: Path | None
    claims: list[dict[str, str]]
    cached: bool


def canonical(config: Experiment) -> str:
    """The resolved experiment as one line of JSON: keys sorted, floats in shortest form, −0 as 0."""
    return json.dumps(_canonical(config.resolve().plain()), sort_keys=True, separators=(",", ":"), allow_nan=False)


def digest(config: Experiment, datasets: Mapping[str, str], result: int | None = None) -> str:
    """Hash of all that decides the numbers: resolved experiment, datasets' hashes, result version (this livlab's)."""
    version = RESULT_VERSION if result is None else result
    parts = {"config": canonical(config), "datasets": dict(sorted(datasets.items())), "result": version}
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def folder_of(config: Experiment, identity: str, base: Path) -> Path:
    """Where a run with this digest lives."""
    return base / f"{config.name}-{identity[:12]}"


def execute(
    config: Experiment,
    *,
    base: Path | str = "runs",
    force: bool = False,
    command: str = "",
    progress: Progress | None = None,
    report: bool = True,
    scheduler: str = "local",
    shared: Path | None = None,
) -> Outcome:
    """Run an experiment, or find that it has been run.

    Parameters
    ----------
    config
        The experiment; it is resolved first.
    base
        Folder that holds the run folders.
    force
        Do it again even if the result is there.
    command
        How to run it again, for the manifest.
    progress
        Who watches.
    report
        Whether to build the report.
    scheduler
        Where the jobs of a study run: "local", "processes:N" or "tcp://HOST:PORT".
    shared
        Folder of job results that several runs share.

    Raises
    ------
    EnvironmentProblem
        The folder cannot be written, another process works on it, or the variant needs a GPU that is not there.
    DatasetError
        A dataset it needs is missing or was tampered with.
    Interrupted
        The user stopped it; calling again goes on.
    """
    progress = progress or Silent()
    config = config.resolve()
    hashes = dataset_hashes(config.datasets())
    identity = digest(config, hashes)
    folder = folder_of(config, identity, Path(base))
    if not force and is_complete(folder, identity):
        return _outcome(folder, _report(folder, report, only_missing=True), cached=True)
    check_device(config, scheduler)
    open_folder(Path(base))
    work: Callable[[Run], None] = KINDS[config.plain()["kind"]].load_job()(config)
    open_folder(folder)
    with locked(folder):
        if not force and is_complete(folder, identity):
            return _outcome(folder, _report(folder, report, only_missing=True), cached=True)
        run = Run(folder, config, identity, progress, scheduler=scheduler, shared=shared, again=force)
        if force:
            run.drop_pieces()
        _work(run, work, command or f"livlab run {folder / 'config.toml'}", hashes, again=force)
        return _outcome(folder, _report(folder, report, only_missing=False), cached=False)


def check_device(config: Experiment, scheduler: str = "local") -> None:
    """Refuse a variant for which this machine has no GPU, before anything is written.

    A Dask cluster's workers have GPUs of their own: whether they do shows there.

    Raises
    ------
    EnvironmentProblem
        `variant = "cuda"`, and no NVIDIA GPU that Dr.Jit can use.
    """
    plain = config.plain()
    places = {"variant": plain, "sampling.variant": plain.get("sampling", {})}
    asked = [key for key, table in places.items() if table.get("variant") == "cuda"]
    if not asked or scheduler.startswith("tcp:"):
        return
    from livlab.model.transport.device import device

    try:
        device("cuda")
    except EnvironmentProblem as error:
        raise EnvironmentProblem(
            f"{asked[0]} = 'cuda': this machine has no NVIDIA GPU, or no driver for it.",
            remedy=f'Set {asked[0]} = "llvm" to run on the processor, or run it where `livlab doctor` names a GPU.',
        ) from error


def is_complete(folder: Path, identity: str = "") -> bool:
    """Whether a folder holds a finished run whose files are as they were written."""
    manifest = read_manifest(folder)
    if manifest.get("status") != "complete" or (identity and manifest.get("digest") != identity):
        return False
    try:
        return all(plain_file(folder, name) and sha256(folder / name) == x for name, x in manifest["files"].items())
    except (OSError, KeyError, AttributeError):
        return False


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest, or nothing if there is none that can be read."""
    try:
        path = readable(folder / "manifest.json", "manifest", LARGEST_MANIFEST)
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):  # an InputError is a ValueError
        return {}
    return found if isinstance(found, dict) else {}


def dataset_hashes(names: Sequence[str]) -> dict[str, str]:
    """Hash of each dataset, after its table was held against its own meta.toml.

    Raises
    ------
    DatasetError
        One is missing, or its table is not the one that its hash was taken of.
    """
    if not names:
        return {}
    from livlab import datasets

    return {name: datasets.load(name).meta.sha256 for name in sorted(set(names))}


def _work(run: Run, work: Callable[[Run], None], command: str, hashes: Mapping[str, str], *, again: bool) -> None:
    before = {} if again else read_manifest(run.folder)
    spent = before.get("seconds", 0.0) if before.get("digest") == run.digest else 0.0
    spent = float(spent) if isinstance(spent, (int, float)) and 0.0 <= spent < 1e12 else 0.0
    started = str(before.get("started")) if spent else None
    clock = time.monotonic()
    manifest: dict[str, Any] = {
        "name": run.config.name,
        "kind": run.config.plain().get("kind", ""),
        "title": run.config.title,
        "digest": run.digest,
        "result_version": RESULT_VERSION,
        "livlab": __version__,
        "command": command,
        "seed": run.config.seed,
        "datasets": dict(hashes),
        "started": started or _now(),
        **machine(),
    }

    def write_manifest(status: str) -> None:
        seconds = spent + time.monotonic() - clock
        full = {
            **manifest,
            **run.info,
            "status": status,
            "finished": _now() if status == "complete" else None,
            "seconds": round(seconds, 3),
            "notes": run.notes,
            "files": run.written if status == "complete" else {},
            "results": timeless_hashes(run.folder, run.written) if status == "complete" else {},
            "experiment": to_toml(run.config),
        }
        write_whole(run.folder / "manifest.json", json.dumps(full, indent=2, ensure_ascii=False) + "\n")

    write_manifest("partial")
    run.write("config.toml", to_toml(run.config))
    try:
        with _listening(run):
            work(run)
            write_manifest("complete")
    except KeyboardInterrupt:
        write_manifest("partial")
        raise Interrupted(
            f"Stopped at once; what was saved before is kept in {run.folder}.",
            remedy="Give the same command again to go on.",
        ) from None
    except Interrupted:
        write_manifest("partial")
        raise
    run.drop_pieces()


@contextlib.contextmanager
def _listening(run: Run) -> Iterator[None]:
    """A first Ctrl-C (or SIGTERM) asks the run to stop when its batch is saved; a second stops it at once."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def hear(number: int, _frame: FrameType | None) -> None:
        if run.stopping.is_set():
            raise KeyboardInterrupt
        run.stopping.set()
        run.progress.say("Stopping when this batch is saved; once more stops at once.")

    old = {number: signal.signal(number, hear) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)


def _report(folder: Path, wanted: bool, *, only_missing: bool) -> Path | None:
    page = folder / "report.html"
    if not wanted:
        return page if page.exists() else None
    if only_missing and page.exists():
        return page
    return rebuild_report(folder)


def rebuild_report(folder: Path) -> Path:
    """Build the report of a run folder again, from its files alone."""
    from livlab.reports.page import build_report

    try:
        return build_report(folder)
    except OSError as error:
        raise EnvironmentProblem(
            f"The result is kept in {folder}, but its report cannot be written: {error.strerror or error}.",
            remedy=f"Mend that, then: livlab report {folder}",
        ) from error


def _outcome(folder: Path, report: Path | None, *, cached: bool) -> Outcome:
    claims = folder / "claims.csv"
    return Outcome(folder, report, read_csv(claims) if claims.exists() else [], cached)


def machine() -> dict[str, Any]:
    """The machine and the versions of what computes, as a manifest has them."""
    import os
    from importlib import metadata

    packages = {}
    for name in _PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            packages[name] = metadata.version(name)
    return {
        "packages": packages,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "machine": platform.machine(),
        "processor": processor(),
        "code": code(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "memory_gib": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
        "libllvm": None,
        "variant": None,
    }


def _canonical(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _canonical(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_canonical(v) for v in value]
    if isinstance(value, float):
        if not math.isfinite(value):
            return str(value)
        return value + 0.0
    return value


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
