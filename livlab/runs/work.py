"""One run at work: what a job gets to keep its pieces, write its files, tell its progress and hear a Ctrl-C."""

from __future__ import annotations

import contextlib
import hashlib
import json
import shutil
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from livlab.config.schema import Experiment
from livlab.errors import Interrupted
from livlab.runs.files import csv_text, sha256, told_plainly, write_whole

if TYPE_CHECKING:
    import xarray as xr

    from livlab.criteria import Claim

PIECES = ".pieces"
"""Folder of what a run has finished; gone when it is complete."""


Table = tuple[Sequence[str], Sequence[Mapping[str, object]]]
"""Columns and rows of a CSV table."""


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
    scheduler
        Where jobs run, as `livlab.jobs.scheduler.open_scheduler` reads it; it decides no number.
    shared
        Folder of job results that several runs share, None for none.
    again
        Whether everything is to be computed again.
    """

    folder: Path
    config: Experiment
    digest: str
    progress: Progress = field(default_factory=Silent)
    notes: list[str] = field(default_factory=list)
    info: dict[str, Any] = field(default_factory=dict)
    written: dict[str, str] = field(default_factory=dict)
    stopping: threading.Event = field(default_factory=threading.Event)
    scheduler: str = "local"
    shared: Path | None = None
    again: bool = False

    def note(self, text: str) -> None:
        """Keep a warning for the report, once."""
        if text not in self.notes:
            self.notes.append(text)
            self.progress.say(text)

    def write(self, name: str, content: bytes | str | memoryview) -> None:
        """Write one file of the result, whole or not at all."""
        write_whole(self.folder / name, content)
        self.written[name] = sha256(self.folder / name)

    def keep(self, name: str) -> None:
        """Count a file of the folder, written whole by another, as part of the result."""
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

    def finish(
        self,
        claims: Sequence[Claim],
        tables: Mapping[str, Table],
        costs: Table,
        notes: Mapping[str, str] | None = None,
    ) -> None:
        """Write what every run ends with: its tables, costs.csv, claims.csv; the manifest gets the claims' notes.

        Parameters
        ----------
        claims
            What is judged.
        tables
            By file name.
        costs
            What each stage took.
        notes
            By claim, what is told of one that has no note of its own.
        """
        for name, (columns, rows) in {**tables, "costs.csv": costs}.items():
            self.write_table(name, columns, rows)
        self.write_claims(claims)
        self.info["claim_notes"] = {**(notes or {}), **{c.criterion: c.note for c in claims if c.note}}

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

    def drop_pieces(self) -> None:
        """Forget all saved pieces."""
        with told_plainly(self.folder / PIECES), contextlib.suppress(FileNotFoundError):
            shutil.rmtree(self.folder / PIECES)

    def _pieces(self) -> Path:
        folder = self.folder / PIECES
        with told_plainly(folder):
            folder.mkdir(exist_ok=True)
        return folder


class PieceUnderWay:
    """A piece that takes long: kept every so often, and when the user wants to stop, so that a later call goes on.

    Parameters
    ----------
    run
        Whose piece it is.
    name
        What the piece is called.
    every_seconds
        It is kept this often at most.
    most_share
        Keeping it takes at most this share of the time.
    beside
        Called whenever it has been kept.
    """

    def __init__(
        self,
        run: Run,
        name: str,
        *,
        every_seconds: float,
        most_share: float = 1.0,
        beside: Callable[[], None] | None = None,
    ) -> None:
        self._run, self._name, self._every, self._share, self._beside = run, name, every_seconds, most_share, beside
        self._kept, self._cost = time.monotonic(), 0.0

    def load(self) -> xr.Dataset | None:
        """As an earlier call left it, or None."""
        return self._run.load_piece(self._name)

    def keep(self, data: xr.Dataset) -> None:
        """Keep it as it stands."""
        began = time.monotonic()
        self._run.save_piece(self._name, data)
        if self._beside is not None:
            self._beside()
        self._kept = time.monotonic()
        self._cost = self._kept - began

    def step(self, data: Callable[[], xr.Dataset]) -> None:
        """After each step of the work: keep it if it is time to, and end here if the user wants to stop.

        Raises
        ------
        Interrupted
            The user wants to stop; the piece is kept.
        """
        due = max(self._every, self._cost / self._share)
        if self._run.stopping.is_set() or time.monotonic() - self._kept > due:
            self.keep(data())
        self._run.stop_if_asked()


def _stem(name: str) -> str:
    kept = "".join(c if c.isalnum() and c.isascii() else "_" for c in name)[:40]
    return f"{kept}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"
