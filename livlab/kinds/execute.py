"""Run folders: from a resolved experiment to a folder that says what came out, from what, and how to get it again.

A folder is named by the experiment and the digest of everything that decides its numbers, so the same experiment
finds its result, and a changed one makes a new folder. Work is kept in pieces: a run that was stopped goes on.
"""

from __future__ import annotations

import contextlib
import json
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType
from typing import Any

from livlab.config.kinds import KINDS
from livlab.config.load import to_toml
from livlab.config.schema import Experiment
from livlab.errors import EnvironmentProblem, Interrupted
from livlab.kinds.report import rebuild_report
from livlab.machine.version import __version__
from livlab.runs.compare import timeless_hashes
from livlab.runs.files import locked, open_folder, read_csv, write_whole
from livlab.runs.identity import RESULT_VERSION, dataset_hashes, digest, folder_of, is_complete, machine, read_manifest
from livlab.runs.work import Progress, Run, Silent


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


def _outcome(folder: Path, report: Path | None, *, cached: bool) -> Outcome:
    claims = folder / "claims.csv"
    return Outcome(folder, report, read_csv(claims) if claims.exists() else [], cached)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
