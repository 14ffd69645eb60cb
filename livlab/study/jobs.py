"""Jobs: a kind and a payload of plain values, known by their digest, each a pure function from JSON to JSON.

Where a job runs, and in which order, changes nothing: whatever it draws it draws from a seed made of the study's seed
and its own digest. So results can be kept by digest (`livlab.study.store`) and jobs sent anywhere
(`livlab.study.scheduler`).
"""

from __future__ import annotations

import hashlib
import importlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

from livlab.errors import EnvironmentProblem, InputError, LivlabError
from livlab.runs_work import Progress, Silent

JOBS: dict[str, str] = {}
"""Every kind of job as "module:function", imported on use; the function takes the payload and returns a dict."""


@dataclass(frozen=True)
class Job:
    """What is to be computed, in plain values.

    Attributes
    ----------
    kind
        A key of `JOBS`.
    payload
        Numbers, strings, lists and dicts: all that decides the result.
    """

    kind: str
    payload: Mapping[str, Any]

    @cached_property
    def text(self) -> str:
        """The job as one line of JSON, keys sorted.

        Raises
        ------
        InputError
            The payload is not JSON, or holds nan or inf.
        """
        try:
            return json.dumps(
                {"kind": self.kind, "payload": self.payload}, sort_keys=True, separators=(",", ":"), allow_nan=False
            )
        except (TypeError, ValueError) as error:
            raise InputError.of(
                f"job {self.kind}", self.payload, f"must be JSON ({error})", "Use plain values."
            ) from None

    @cached_property
    def digest(self) -> str:
        """SHA-256 of `text`: the job's identity.

        >>> Job("walk", {"a": 1, "b": 2}).digest == Job("walk", {"b": 2, "a": 1}).digest
        True
        """
        return hashlib.sha256(self.text.encode()).hexdigest()

    def seed(self, study_seed: int) -> int:
        """Seed of this job's random draws, 0 to 2³¹ − 1: a hash of the study's seed and the job's digest."""
        mixed = hashlib.sha256(f"{study_seed}:{self.digest}".encode()).digest()
        return int.from_bytes(mixed[:4], "big") >> 1

    @classmethod
    def read(cls, text: str) -> Job:
        """The job of which `text` is the JSON."""
        said = json.loads(text)
        return cls(said["kind"], said["payload"])


@dataclass(frozen=True)
class Answer:
    """What came of a job: a result, or why there is none.

    Attributes
    ----------
    job
        The job.
    result
        Its result, None where it failed.
    error
        Why it failed.
    """

    job: Job
    result: dict[str, Any] | None = None
    error: LivlabError | None = None


class Scheduler(Protocol):
    """Where jobs run."""

    def run(self, jobs: Sequence[Job], say: Callable[[str], None]) -> Iterator[Answer]:
        """Answer every job once, in any order; closing the iterator drops what is not begun."""


class Keeper(Protocol):
    """Where results are kept: `livlab.study.store.Store`."""

    def get(self, digest: str) -> dict[str, Any] | None:
        """A result, or None."""

    def put(self, digest: str, result: Mapping[str, Any]) -> None:
        """Keep a result."""


class Local:
    """Jobs one after the other in this process."""

    def run(self, jobs: Sequence[Job], say: Callable[[str], None] = print) -> Iterator[Answer]:
        """Answer every job once, in order."""
        for job in jobs:
            yield answer(job)


class JobsFailed(LivlabError):
    """Some jobs failed; the results of all others are kept."""


@dataclass
class Tally:
    """How the jobs of a call were answered."""

    found: int = 0
    computed: int = 0
    failed: list[Answer] = field(default_factory=list)


def run_job(job: Job) -> dict[str, Any]:
    """Compute a job here and now.

    Raises
    ------
    InputError
        No such kind, or a result that is not JSON.
    LivlabError
        Whatever the job raises.
    """
    if job.kind not in JOBS:
        raise InputError.of("job", job.kind, f"must be one of {', '.join(sorted(JOBS))}", "Name a kind there is.")
    module, _, name = JOBS[job.kind].partition(":")
    made = getattr(importlib.import_module(module), name)(job.payload)
    try:
        # What is kept and what was just computed shall be the same thing.
        result = json.loads(json.dumps(made))
    except (TypeError, ValueError) as error:
        raise InputError.of(f"result of {job.kind}", made, f"must be JSON ({error})", "Mend the job.") from None
    if not isinstance(result, dict):
        raise InputError.of(f"result of {job.kind}", made, "must be a dict", "Mend the job.")
    return result


def answer(job: Job) -> Answer:
    """Compute a job here; what livlab raises on purpose becomes part of the answer."""
    try:
        return Answer(job, run_job(job))
    except LivlabError as error:
        return Answer(job, None, error)


def run_jobs(
    jobs: Iterable[Job],
    scheduler: Scheduler | None = None,
    store: Keeper | None = None,
    progress: Progress | None = None,
    *,
    task: str = "jobs",
    stop: Callable[[], None] | None = None,
    tally: Tally | None = None,
) -> list[dict[str, Any]]:
    """Compute jobs, or find that they have been.

    Parameters
    ----------
    jobs
        In any number; equal ones are computed once.
    scheduler
        Where they run; in this process if not said.
    store
        Where results are looked up and kept; nowhere if not said.
    progress
        Told how far it is, under the name `task`.
    stop
        Called after every answer that was kept; may raise to end here (`Run.stop_if_asked`).
    tally
        Filled in with how many were found and computed.

    Returns
    -------
    The results in the order of the jobs.

    Raises
    ------
    JobsFailed
        After all others were answered and kept: some failed. `EnvironmentProblem` if the first failed by one.
    """
    progress, tally = progress or Silent(), tally if tally is not None else Tally()
    wanted = list(jobs)
    known: dict[str, dict[str, Any]] = {}
    left: dict[str, Job] = {}
    for job in wanted:
        found = store.get(job.digest) if store is not None and job.digest not in left else None
        if found is not None:
            known[job.digest] = found
        elif job.digest not in known:
            left[job.digest] = job
    tally.found = len(known)
    count = len(known) + len(left)
    if left:
        answers = (scheduler or Local()).run(list(left.values()), progress.say)
        try:
            for got in answers:
                if got.result is None:
                    tally.failed.append(got)
                else:
                    known[got.job.digest] = got.result
                    tally.computed += 1
                    if store is not None:
                        store.put(got.job.digest, got.result)
                progress.advance(task, (len(known) + len(tally.failed)) / count, f"{len(known)} of {count}")
                if stop is not None:
                    stop()
        finally:
            close = getattr(answers, "close", None)
            if close is not None:
                close()
    if tally.failed:
        raise _failed(tally.failed, count)
    return [known[job.digest] for job in wanted]


def _failed(failed: Sequence[Answer], count: int) -> LivlabError:
    first = failed[0]
    error = first.error or InputError("It gave no result.")
    kind = EnvironmentProblem if isinstance(error, EnvironmentProblem) else JobsFailed
    which = ", ".join(f"{x.job.kind} {x.job.digest[:12]}" for x in failed[:8]) + (" …" if len(failed) > 8 else "")
    return kind(
        f"{len(failed)} of {count} jobs failed ({which}); the others' results are kept. The first: {error.message}",
        remedy=error.remedy,
    )
