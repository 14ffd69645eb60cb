"""Jobs of a study: plain data with a digest, an answer that follows from it alone, and whoever keeps and runs them.

This is the seam to any scheduler: a job is JSON in, JSON out. `run_job` works in any process that can import livlab;
what it answers depends on the job and on nothing else, so that an answer kept under the job's digest serves for ever.
"""

from __future__ import annotations

import hashlib
import importlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

from livlab.errors import InputError, Interrupted

ANSWER_VERSION = 1
"""Raised whenever the same job would give other numbers than before; it is part of the digest."""

Answer = dict[str, Any]
"""Plain JSON types only."""

EVALUATORS: dict[str, str] = {
    "spectrum": "livlab.kinds.study.evaluate:spectrum",
    "ledger": "livlab.kinds.study.evaluate:ledger",
}
"""What answers each kind of job, as "module:function" from payload to answer, imported on use."""


@dataclass(frozen=True)
class Job:
    """A piece of work: its kind, and all that decides its answer, as plain JSON types.

    Examples
    --------
    >>> Job("spectrum", {"b": 1, "a": 0.5}).digest == Job("spectrum", {"a": 0.5, "b": 1}).digest
    True
    """

    kind: str
    payload: Mapping[str, Any]

    @cached_property
    def digest(self) -> str:
        """Hash of all that decides the answer; the same for the same content, whatever its order."""
        parts = {"kind": self.kind, "payload": self.payload, "version": ANSWER_VERSION}
        text = json.dumps(parts, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


class AnswerStore(Protocol):
    """Where answers are kept by digest, whole or not at all: `livlab.jobs.store.Store` in files."""

    def load(self, digest: str) -> Answer | None:
        """The answer, or None if there is none that is sound."""

    def save(self, digest: str, answer: Answer) -> None:
        """Keep an answer."""


class Scheduler(Protocol):
    """Who runs jobs; the order in which they end is its own affair."""

    def run(self, jobs: Sequence[Job]) -> Iterator[tuple[int, Answer]]:
        """Each job's number and answer, as it ends; closing the iterator gives the rest up."""


class LocalScheduler:
    """One job after the other, in this process."""

    def run(self, jobs: Sequence[Job]) -> Iterator[tuple[int, Answer]]:
        """Each job's number and answer."""
        for k, job in enumerate(jobs):
            yield k, run_job(job)


class MemoryStore:
    """Answers kept while the process lives."""

    def __init__(self) -> None:
        self.answers: dict[str, Answer] = {}

    def load(self, digest: str) -> Answer | None:
        """The answer, or None."""
        return self.answers.get(digest)

    def save(self, digest: str, answer: Answer) -> None:
        """Keep an answer."""
        self.answers[digest] = answer


def run_job(job: Job) -> Answer:
    """What a job answers: a pure function of the job.

    Raises
    ------
    InputError
        An unknown kind of job.
    """
    if job.kind not in EVALUATORS:
        raise InputError.of("job.kind", job.kind, f"must be one of {', '.join(EVALUATORS)}", "Pick one.")
    module, _, name = EVALUATORS[job.kind].partition(":")
    answer: Answer = getattr(importlib.import_module(module), name)(job.payload)
    return answer


def run_jobs(
    jobs: Sequence[Job],
    scheduler: Scheduler | None = None,
    store: AnswerStore | None = None,
    progress: Callable[[int, int], None] | None = None,
    stopping: Callable[[], bool] | None = None,
) -> list[Answer]:
    """The answers of jobs, in their order; what the store has is not done again, and equal jobs are done once.

    Parameters
    ----------
    jobs
        What is to be answered.
    scheduler
        Who runs them; this process if not said.
    store
        Where answers are looked up and kept, each as soon as it is there.
    progress
        Called with how many are answered, and of how many.
    stopping
        Asked after each answer whether the user wants to stop.

    Raises
    ------
    Interrupted
        The user wanted to stop; what was answered is in the store.
    """
    scheduler, store = scheduler or LocalScheduler(), store if store is not None else MemoryStore()
    found: dict[str, Answer] = {}
    wanted: dict[str, Job] = {}
    for job in jobs:
        if job.digest not in found and job.digest not in wanted:
            kept = store.load(job.digest)
            if kept is None:
                wanted[job.digest] = job
            else:
                found[job.digest] = kept
    tell = progress or (lambda done, total: None)
    total = len(found) + len(wanted)
    tell(len(found), total)
    open_jobs = list(wanted.values())
    running = scheduler.run(open_jobs)
    try:
        for number, answer in running:
            digest = open_jobs[number].digest
            store.save(digest, answer)
            found[digest] = answer
            tell(len(found), total)
            if stopping is not None and stopping() and len(found) < total:
                raise Interrupted("The study was stopped.", remedy="Give the same command again.")
    finally:
        close = getattr(running, "close", None)
        if close is not None:
            close()
    return [found[job.digest] for job in jobs]
