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
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Protocol

from livlab import __version__
from livlab.config import KINDS, Experiment, to_toml
from livlab.errors import EnvironmentProblem, Interrupted
from livlab.runs_files import csv_text, locked, open_folder, read_csv, sha256, told_plainly, write_whole

if TYPE_CHECKING:
    import xarray as xr

    from livlab.criteria import Claim

RESULT_VERSION = 1
"""Raised whenever the same experiment would give other numbers than before; it is part of the digest."""

PIECES = ".pieces"
"""Folder of what a run has finished; gone when it is complete."""

_PACKAGES = ("numpy", "scipy", "xarray", "pandas", "pydantic", "miepython", "numba", "drjit", "mitsuba")


class Progress(Protocol):
    """What a run tells of itself while it works."""

    def begin(self, tasks: Sequence[str]) -> None:
        """Name the tasks to come."""

    def advance(self, task: str, share: float, text: str = "") -> None:
        """One task has come to `share` (0 to 1) of its work."""

    def say(self, text: str) -> None:
        """One line for the user."""


class Silent:
    """Progress that nobody watches."""

    def begin(self, tasks: Sequence[str]) -> None:
        """Say nothing."""

    def advance(self, task: str, share: float, text: str = "") -> None:
        """Say nothing."""

    def say(self, text: str) -> None:
        """Say nothing."""


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


@dataclass
class Run:
    """One run at work: what a job gets to keep its pieces, write its files and hear a Ctrl-C.

    Attributes
    ----------
    folder, config, digest
        Where it writes, what it does, and the digest of both config and datasets.
    notes
        Warnings that the report must show.
    info
        Further entries of the manifest.
    """

    folder: Path
    config: Experiment
    digest: str
    progress: Progress = field(default_factory=Silent)
    notes: list[str] = field(default_factory=list)
    info: dict[str, Any] = field(default_factory=dict)
    written: dict[str, str] = field(default_factory=dict)
    stopping: threading.Event = field(default_factory=threading.Event)

    def note(self, text: str) -> None:
        """Keep a warning for the report, once."""
        if text not in self.notes:
            self.notes.append(text)
            self.progress.say(text)

    def write(self, name: str, content: bytes | str | memoryview) -> None:
        """Write one file of the result, whole or not at all."""
        write_whole(self.folder / name, content)
        self.written[name] = sha256(self.folder / name)

    def write_table(self, name: str, columns: Sequence[str], rows: Sequence[Mapping[str, object]]) -> None:
        """Write a CSV table."""
        self.write(name, csv_text(columns, rows))

    def write_claims(self, claims: Sequence[Claim]) -> None:
        """Write claims.csv, and the notes of its claims beside it."""
        from livlab.criteria import write_claims

        scratch = self._pieces()
        with told_plainly(self.folder / "claims.csv"):
            write_claims(scratch / "claims.csv", claims)
        for made in ("claims.csv", "claims.notes.json"):
            if (scratch / made).exists():
                self.write(made, (scratch / made).read_bytes())

    def write_result(self, groups: Mapping[str, xr.Dataset]) -> None:
        """Write result.nc; the key "/" is the root group."""
        import xarray as xr

        tree = xr.DataTree.from_dict(dict(groups))
        self.write("result.nc", tree.to_netcdf(None, engine="h5netcdf"))

    def save_piece(self, name: str, data: xr.Dataset) -> None:
        """Keep finished work, so that a run stopped hereafter goes on from it."""
        folder = self._pieces()
        raw = bytes(data.to_netcdf(engine="h5netcdf"))
        stem = _stem(name)
        write_whole(folder / f"{stem}.nc", raw)
        seal = {"name": name, "digest": self.digest, "sha256": hashlib.sha256(raw).hexdigest()}
        write_whole(folder / f"{stem}.json", json.dumps(seal))

    def load_piece(self, name: str) -> xr.Dataset | None:
        """Work that an earlier call finished, or None; a damaged piece is put aside with a note, and done again."""
        import io

        import xarray as xr

        stem = self.folder / PIECES / _stem(name)
        data, seal = stem.with_suffix(".nc"), stem.with_suffix(".json")
        if not (data.exists() and seal.exists()):
            return None
        try:
            said = json.loads(seal.read_text(encoding="utf-8"))
            raw = data.read_bytes()
            if said["digest"] != self.digest or said["sha256"] != hashlib.sha256(raw).hexdigest():
                raise ValueError("its hash differs")
            with xr.open_dataset(io.BytesIO(raw), engine="h5netcdf") as opened:
                return opened.load()
        except (OSError, ValueError, KeyError, TypeError) as error:
            self.note(f"The saved part {name!r} was damaged ({error}); it was computed again.")
            data.unlink(missing_ok=True)
            seal.unlink(missing_ok=True)
            return None

    def stop_if_asked(self) -> None:
        """End here if the user pressed Ctrl-C; call it when what was done is saved.

        Raises
        ------
        Interrupted
            The user wants to stop.
        """
        if self.stopping.is_set():
            raise Interrupted(
                f"Stopped; what was done is kept in {self.folder}.", remedy="Give the same command again to go on."
            )

    def _pieces(self) -> Path:
        folder = self.folder / PIECES
        with told_plainly(folder):
            folder.mkdir(exist_ok=True)
        return folder


def canonical(config: Experiment) -> str:
    """The resolved experiment as one line of JSON: keys sorted, floats in shortest form, −0 as 0."""
    return json.dumps(_canonical(config.resolve().plain()), sort_keys=True, separators=(",", ":"), allow_nan=False)


def digest(config: Experiment, datasets: Mapping[str, str]) -> str:
    """Hash of all that decides the numbers: resolved experiment, datasets' hashes, result version."""
    parts = {"config": canonical(config), "datasets": dict(sorted(datasets.items())), "result": RESULT_VERSION}
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

    Raises
    ------
    EnvironmentProblem
        The folder cannot be written, or another process works on it.
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
    open_folder(Path(base))
    work: Callable[[Run], None] = KINDS[config.plain()["kind"]].load_job()(config)
    open_folder(folder)
    with locked(folder):
        if not force and is_complete(folder, identity):
            return _outcome(folder, _report(folder, report, only_missing=True), cached=True)
        run = Run(folder, config, identity, progress)
        if force:
            _drop_pieces(folder)
        _work(run, work, command or f"livlab run {folder / 'config.toml'}", hashes, again=force)
        return _outcome(folder, _report(folder, report, only_missing=False), cached=False)


def is_complete(folder: Path, identity: str = "") -> bool:
    """Whether a folder holds a finished run whose files are as they were written."""
    manifest = read_manifest(folder)
    if manifest.get("status") != "complete" or (identity and manifest.get("digest") != identity):
        return False
    try:
        return all(sha256(folder / name) == known for name, known in manifest["files"].items())
    except (OSError, KeyError, AttributeError):
        return False


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest, or nothing if there is none that can be read."""
    try:
        found = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
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
    spent = float(before.get("seconds", 0.0)) if before.get("digest") == run.digest else 0.0
    started = before.get("started") if spent else None
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
        **_machine(),
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
    _drop_pieces(run.folder)


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


def _drop_pieces(folder: Path) -> None:
    with told_plainly(folder / PIECES), contextlib.suppress(FileNotFoundError):
        shutil.rmtree(folder / PIECES)


def _machine() -> dict[str, Any]:
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


def _stem(name: str) -> str:
    kept = "".join(c if c.isalnum() and c.isascii() else "_" for c in name)[:40]
    return f"{kept}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
