"""Results by content: one file a job, named by the job's digest, whole or not there, and checked when it is read.

A study that was stopped, or whose machine was, finds here what it has done. A file that was damaged is put aside and
its job done again; a file of another version of the numbers is passed over.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from livlab.core.files import told_plainly, write_whole
from livlab.errors import EnvironmentProblem, InputError

if TYPE_CHECKING:
    from livlab.runs.work import Run

FORM = 1
"""Version of a result file's form."""

_DIGEST = re.compile(r"[0-9a-f]{64}")


@dataclass
class Store:
    """A folder of results, and perhaps a second one that several runs and users share.

    Attributes
    ----------
    folder
        Where every result is kept; made on the first write.
    shared
        A folder in which results of other runs are looked up and to which new ones are copied; None for none. When
        it cannot be written the study goes on without it, with a note.
    versions
        What must agree for a result to be of use, such as ``{"result": 1}``; written into each file.
    trust_shared
        Whether to take results from `shared`; a run that is to compute everything again does not.
    notes
        What the user should know: damaged files, a shared folder that cannot be written.
    """

    folder: Path
    shared: Path | None = None
    versions: Mapping[str, Any] = field(default_factory=dict)
    trust_shared: bool = True
    notes: list[str] = field(default_factory=list)

    def load(self, digest: str) -> dict[str, Any] | None:
        """Look a result up.

        Parameters
        ----------
        digest
            SHA-256 of the job, 64 hexadecimal digits.

        Returns
        -------
        The result, or None where there is none, or only a damaged one, or one of other versions.

        Raises
        ------
        InputError
            Not a digest.
        """
        found = self._read(self.folder, digest)
        if found is None and self.shared is not None and self.trust_shared:
            found = self._read(self.shared, digest)
            if found is not None:
                write_whole(self._made(self.folder, digest), _sealed(digest, found, self.versions))
        return found

    def save(self, digest: str, answer: Mapping[str, Any]) -> None:
        """Keep a result, whole or not at all.

        Raises
        ------
        InputError
            Not a digest, or a result that is not JSON.
        EnvironmentProblem
            The folder cannot be written.
        """
        text = _sealed(digest, answer, self.versions)
        write_whole(self._made(self.folder, digest), text)
        if self.shared is None:
            return
        try:
            write_whole(self._made(self.shared, digest), text)
        except EnvironmentProblem as problem:
            self._note(f"Results are kept in this run alone from here on: {problem.message}")
            self.shared = None

    def path(self, digest: str, folder: Path | None = None) -> Path:
        """File of a job's result; the first two digits are its folder, so that no folder holds too many.

        >>> Store(Path("jobs")).path("ab" + 62 * "0").parts[:2]
        ('jobs', 'ab')
        """
        if not _DIGEST.fullmatch(digest):
            raise InputError.of("digest", digest, "must be 64 hexadecimal digits", "Give Job.digest.")
        return (folder or self.folder) / digest[:2] / f"{digest}.json"

    def _made(self, folder: Path, digest: str) -> Path:
        path = self.path(digest, folder)
        with told_plainly(path):
            path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def _read(self, folder: Path, digest: str) -> dict[str, Any] | None:
        path = self.path(digest, folder)
        try:
            raw = path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            self._note(f"{path} cannot be read ({error.strerror}); its job is done again.")
            return None
        try:
            said = json.loads(raw)
            result, body = said["result"], _text(said["result"])
            if said["form"] != FORM or said["digest"] != digest or not isinstance(result, dict):
                raise ValueError("it is not the file of this job")
            if said["sha256"] != _hash(digest, body, said["versions"]):
                raise ValueError("its hash differs")
        except (ValueError, KeyError, TypeError) as error:
            self._note(f"The stored result {digest[:12]} was damaged ({error}); its job is done again.")
            with contextlib.suppress(OSError):
                path.unlink()
            return None
        return result if said["versions"] == dict(self.versions) else None

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)


def store_of(run: Run) -> Store:
    """The store of a run: a folder of its own, and the shared one if the user named one.

    A run that is to be done again takes nothing from the shared folder, but renews it.
    """
    from livlab.jobs.scheduler.worker import versions
    from livlab.runs.work import PIECES

    return Store(run.folder / PIECES / "jobs", run.shared, versions(), trust_shared=not run.again)


def _sealed(digest: str, result: Mapping[str, Any], versions: Mapping[str, Any]) -> str:
    try:
        body = _text(result)
    except (TypeError, ValueError) as error:
        raise InputError.of(
            f"result of job {digest[:12]}", result, f"must be JSON ({error})", "Mend the job."
        ) from None
    known = dict(versions)
    seal = {"form": FORM, "digest": digest, "versions": known, "sha256": _hash(digest, body, known)}
    return f'{_text(seal)[:-1]},"result":{body}}}\n'


def _text(value: object) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"))


def _hash(digest: str, body: str, versions: object) -> str:
    return hashlib.sha256(f"{digest}\n{_text(versions)}\n{body}".encode()).hexdigest()
