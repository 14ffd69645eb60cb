"""Jobs to a Dask cluster and answers back, whatever becomes of the workers on the way.

No more jobs are given out than keep the workers busy, so that two studies on one cluster take turns, and a scheduler
holds little. A job whose worker died is given out again; one that was there whenever a worker died is tried once more
alone before it is blamed.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from livlab import errors
from livlab.errors import EnvironmentProblem, LivlabError
from livlab.jobs.jobs import Answer, Job
from livlab.jobs.scheduler.worker import facts, parcel, settle, versions, work

LOOK_SECONDS = 1.0
"""How often the workers are counted."""

AHEAD = 2
"""Jobs given out per thread: one at work and one that waits at the worker's door."""

GATHER_SECONDS = 120.0


@dataclass(frozen=True)
class JobOutcome:
    """What came of a job: an answer, or why there is none.

    Attributes
    ----------
    job
        The job.
    answer
        Its answer, None where it failed.
    error
        Why it failed.
    """

    job: Job
    answer: Answer | None = None
    error: LivlabError | None = None


class SchedulerLost(Exception):
    """The connection to the scheduler is gone; what was not answered can be given out anew."""


@dataclass
class _Task:
    """A job on its way.

    Attributes
    ----------
    job
        The job.
    alone
        Whether it is tried with no other job of this study beside it, since workers died of it or of a neighbour.
    lacking
        Workers that could not do it, with what they said.
    pinned
        Workers it may go to, None for any.
    future
        Dask's handle, while it is out.
    """

    job: Job
    alone: bool = False
    lacking: dict[str, dict[str, str]] = field(default_factory=dict)
    pinned: list[str] | None = None
    future: Any = None


class Dispatch:
    """One study's jobs on one connection.

    Parameters
    ----------
    client
        A connected `distributed.Client`.
    jobs
        What is to be done.
    say
        Told what the user should know: workers lost, none there.
    where
        The cluster, in words for messages.
    patience
        Seconds without any worker after which to give up; inf waits for ever, as a queue may want.
    """

    def __init__(
        self, client: Any, jobs: Sequence[Job], say: Callable[[str], None], where: str, patience: float
    ) -> None:
        self._client = client
        self._waiting = deque(_Task(job) for job in jobs)
        self._suspects: deque[_Task] = deque()
        self._out: list[_Task] = []
        self._say = say
        self._where = where
        self._patience = patience
        self._crew: dict[str, int] = {}
        self._facts: dict[str, dict[str, Any]] = {}
        self._noted: set[str] = set()
        self._looked = self._manned = self._told = time.monotonic()
        self._look()

    def outcomes(self) -> Iterator[JobOutcome]:
        """Answer every job once, as they are done.

        Raises
        ------
        SchedulerLost
            The connection is gone.
        EnvironmentProblem
            A worker has other versions, or there has been no worker for too long.
        """
        try:
            while self._waiting or self._out or self._suspects:
                if time.monotonic() - self._looked >= LOOK_SECONDS:
                    self._look()
                self._give_out()
                done = [task for task in self._out if task.future.done()]
                for task in done:
                    self._out.remove(task)
                    got = self._judge(task)
                    if got is not None:
                        yield got
                if not done:
                    time.sleep(0.02)
        finally:
            for task in self._out:
                task.future.release()  # not cancelled: another study may want the same

    def _give_out(self) -> None:
        room = AHEAD * max(1, sum(self._crew.values()))
        while self._waiting and len(self._out) < room and self._crew:
            self._submit(self._waiting.popleft())
        if self._suspects and not self._out and not self._waiting and self._crew:
            self._submit(self._suspects.popleft())

    def _submit(self, task: _Task) -> None:
        sent = parcel(task.job)
        # The same job of two studies is one to Dask; a second try is another, or Dask would hand back the first's end.
        mark = f"{sent}{task.alone}{sorted(task.lacking)}"
        task.pinned = [x for x in self._crew if x not in task.lacking] if task.lacking else None
        key = f"livlab-{hashlib.sha256(mark.encode()).hexdigest()[:32]}"
        task.future = self._client.submit(work, sent, key=key, pure=True, workers=task.pinned, retries=0)
        self._out.append(task)

    def _judge(self, task: _Task) -> JobOutcome | None:
        """What came of a task: an answer, or None where it is tried again."""
        from concurrent.futures import CancelledError

        from distributed import KilledWorker

        status = task.future.status
        if status in {"cancelled", "lost"}:
            return self._again(task)
        if status == "error":
            error = task.future.exception()
            if isinstance(error, KilledWorker):
                return self._suspect(task)
            return JobOutcome(task.job, None, _unexpected(error))
        try:
            said = json.loads(task.future.result(timeout=GATHER_SECONDS))
        except (OSError, TimeoutError, CancelledError):  # its worker died with the result, or the scheduler did
            return self._again(task)
        task.future = None
        place = said["by"]
        if "result" in said:
            return JobOutcome(task.job, said["result"])
        if "refused" in said:
            raise _other_versions(self._named(place), said["refused"])
        if "lacking" in said:
            return self._reroute(task, place, said["lacking"])
        return JobOutcome(task.job, None, _error(said["failed"]))

    def _again(self, task: _Task) -> JobOutcome | None:
        """Give a task out once more, unless there is nobody to give it to."""
        if not self._connected():
            raise SchedulerLost
        task.future = None
        self._waiting.append(task)
        return None

    def _suspect(self, task: _Task) -> JobOutcome | None:
        """A job that was at every death of a worker: guilty if it was alone, else it shall be."""
        task.future = None
        if not task.alone:
            task.alone = True
            self._suspects.append(task)
            return None
        error = LivlabError(
            f"Every worker that tries job {task.job.kind} {task.job.digest} dies of it; it was tried alone, too.",
            remedy="See the workers' logs; if memory is short, start fewer workers with more memory each.",
        )
        return JobOutcome(task.job, None, error)

    def _reroute(self, task: _Task, place: str, told: dict[str, str]) -> JobOutcome | None:
        """A job that its worker's machine cannot do: to another that may, or back to the user."""
        task.lacking[place] = told
        if any(address not in task.lacking for address in self._crew):
            self._note(f"{self._named(place)} cannot do some jobs ({told['message']}); others take them.")
            self._waiting.appendleft(task)
            return None
        places = ", ".join(self._named(x) for x in task.lacking)
        told = {**told, "message": f"No worker can do it. {places}: {told['message']}", "class": "EnvironmentProblem"}
        return JobOutcome(task.job, None, _error(told))

    def _look(self) -> None:
        """Count the workers, meet the new ones, share the cores among them."""
        now = self._looked = time.monotonic()
        if not self._connected():
            raise SchedulerLost
        try:
            crew: dict[str, int] = dict(self._client.nthreads())
        except (OSError, TimeoutError) as error:
            raise SchedulerLost from error
        lost, new = set(self._crew) - set(crew), set(crew) - set(self._crew)
        if lost:
            self._say(f"{len(lost)} of {len(self._crew)} workers lost; their jobs are given out again.")
        if new:
            crew = self._meet(crew, sorted(new))
        self._crew = crew
        if lost or new:
            self._share()
        for task in [t for t in self._out if t.pinned and not set(t.pinned) & set(crew)]:
            self._out.remove(task)
            task.future.release()
            self._waiting.append(task)
        if crew:
            self._manned = now
        elif now - self._manned > self._patience:
            raise EnvironmentProblem(
                f"{self._where} has had no worker for {self._patience:.0f} s.",
                remedy="See why the workers end, then give the same command again: what was done is kept.",
            )
        elif now - max(self._manned, self._told) > 10.0:
            self._told = now + 50.0
            self._say(f"{self._where} has no worker; waiting for one.")

    def _meet(self, crew: dict[str, int], new: list[str]) -> dict[str, int]:
        """Ask new workers who they are; leave out the ones that are gone again.

        Raises
        ------
        EnvironmentProblem
            One has no livlab, or another version of it.
        """
        met = self._client.run(facts, workers=new, on_error="return")
        for address in new:
            said = met.get(address)
            if isinstance(said, ImportError):
                raise EnvironmentProblem(
                    f"Worker {address} has no livlab ({said}).", remedy="Start the workers in livlab's environment."
                )
            if not isinstance(said, dict):
                crew.pop(address)
                continue
            self._facts[address] = said
            if said["versions"] != versions():
                raise _other_versions(self._named(address), said["versions"])
        return crew

    def _share(self) -> None:
        """Divide the cores of a machine among the threads of all workers that may use them."""
        shares: dict[int, list[str]] = {}
        for address in self._crew:
            mine = self._facts[address]
            cores = set(mine["cores"])
            rivals = [
                self._crew[other]
                for other in self._crew
                if self._facts[other]["host"] == mine["host"] and cores & set(self._facts[other]["cores"])
            ]
            shares.setdefault(max(1, len(cores) // max(1, sum(rivals))), []).append(address)
        for threads, group in shares.items():
            self._client.run(settle, threads, workers=group, on_error="return")

    def _connected(self) -> bool:
        return bool(self._client.status == "running")

    def _named(self, address: str) -> str:
        host = self._facts.get(address, {}).get("host", "")
        return f"worker {address}" + (f" on {host}" if host else "")

    def _note(self, text: str) -> None:
        if text not in self._noted:
            self._noted.add(text)
            self._say(text)


def _other_versions(place: str, theirs: dict[str, Any]) -> EnvironmentProblem:
    mine = versions()
    return EnvironmentProblem(
        f"{place[:1].upper()}{place[1:]} has livlab {theirs['livlab']} (results version {theirs['result']}), "
        f"this client livlab {mine['livlab']} (results version {mine['result']}): their numbers may differ.",
        remedy="Install the same livlab on both, and start the workers again.",
    )


def _error(told: dict[str, str]) -> LivlabError:
    """An error of a worker as one of this process, of the same class where it is one of livlab's."""
    kind = getattr(errors, told["class"], LivlabError)
    if not (isinstance(kind, type) and issubclass(kind, LivlabError)):
        kind = LivlabError
    return kind(told["message"], remedy=told["remedy"])


def _unexpected(error: BaseException | None) -> LivlabError:
    """What Dask itself says of a task: a worker that cannot even load the function."""
    return EnvironmentProblem(
        f"A worker could not begin: {type(error).__name__}: {error}",
        remedy="Start the workers in livlab's environment.",
    )
