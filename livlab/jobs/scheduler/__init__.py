"""Where jobs run: in this process, in processes of this machine, or on a Dask cluster; the only door to Dask.

Dask brings messages, counting of workers and restarts. What a job is, what makes its numbers, and where results are
kept is livlab's own (`livlab.jobs.jobs`, `livlab.jobs.store`): losing the cluster loses no result.
"""

from __future__ import annotations

import contextlib
import importlib
import logging
import math
import os
import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

from livlab.errors import EnvironmentProblem, InputError, LivlabError
from livlab.jobs.jobs import Answer, Job, LocalScheduler, Scheduler
from livlab.jobs.scheduler.dispatch import Dispatch, JobOutcome, SchedulerLost

__all__ = ["LOCAL", "Processes", "Remote", "open_scheduler"]

LOCAL = "local"
MOST_PROCESSES = 1024
ADDRESS = re.compile(r"tcp://(?:[A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\]):(\d{1,5})")
FORMS = "Say local, processes:N with N >= 1, or tcp://HOST:PORT."

_INSTALL = "pip install 'livlab[distributed]'"
_BLAMED_AFTER = 1
"""Deaths of workers that a job may be at before it is tried alone."""


def _silent(text: str) -> None:
    """Say nothing."""


def open_scheduler(text: str = LOCAL, say: Callable[[str], None] = _silent) -> Scheduler:
    """The scheduler of a command line's ``--scheduler``.

    Parameters
    ----------
    text
        "local": one job after the other in this process, with all cores each. "processes:N": N processes of this
        machine; "processes" alone: one a core. "tcp://HOST:PORT": the scheduler of a Dask cluster that runs.
    say
        Told of workers lost and the like.

    Raises
    ------
    InputError
        None of these.
    EnvironmentProblem
        All but "local" need the packages dask and distributed.

    Examples
    --------
    >>> open_scheduler("processes:2").count
    2
    >>> open_scheduler("processes:0")
    Traceback (most recent call last):
        ...
    livlab.errors.InputError: --scheduler = 'processes:0': must be a scheduler. Say local, processes:N with N >= 1, or tcp://HOST:PORT.
    """
    if text == LOCAL:
        return LocalScheduler()
    made: Scheduler | None = None
    kind, _, count = text.partition(":")
    if kind == "processes" and (not _ or (count.isdecimal() and 1 <= int(count) <= MOST_PROCESSES)):
        made = Processes(int(count) if count else _cores(), say)
    address = ADDRESS.fullmatch(text)
    if address and 1 <= int(address[1]) <= 65535:
        made = Remote(text, say)
    if made is None:
        raise InputError.of("--scheduler", text, "must be a scheduler", FORMS)
    _dask()
    return made


@dataclass(frozen=True)
class Processes:
    """Processes of this machine, each with its share of the cores and of the memory.

    Attributes
    ----------
    count
        How many, >= 1.
    say
        Told of processes lost and the like.
    preload
        Python files or modules that each loads as it starts, such as one that adds a kind of job.
    environment
        Environment variables of the processes.
    memory_limit
        Of each: "auto" for an equal share of the machine, or such as "2GiB"; one that passes it is started again.
    patience
        Seconds without any process after which to give up.
    """

    count: int
    say: Callable[[str], None] = _silent
    preload: tuple[str, ...] = ()
    environment: tuple[tuple[str, str], ...] = ()
    memory_limit: str = "auto"
    patience: float = 60.0

    def run(self, jobs: Sequence[Job]) -> Iterator[tuple[int, Answer]]:
        """Each job's number and answer, as it ends.

        Raises
        ------
        LivlabError
            Some jobs failed; raised when all others were answered.
        EnvironmentProblem
            The same, where a machine was at fault; or dask is missing, or no process stays alive.
        """
        if not jobs:
            return
        numbers, failed = {job.digest: k for k, job in enumerate(jobs)}, list[JobOutcome]()
        with self.connected(min(self.count, len(jobs))) as client:
            where = f"This machine ({self.count} processes)"
            try:
                yield from _good(Dispatch(client, jobs, self.say, where, self.patience).outcomes(), numbers, failed)
            except SchedulerLost:
                raise EnvironmentProblem(
                    "The processes were lost.", remedy="Give the same command again: what was done is kept."
                ) from None
        _raise_failed(failed, len(jobs))

    @contextlib.contextmanager
    def connected(self, count: int | None = None) -> Iterator[Any]:
        """A client of a cluster on the loopback interface that ends with the context."""
        dask, distributed = _dask()
        settings = {
            "distributed.scheduler.allowed-failures": _BLAMED_AFTER,
            "distributed.scheduler.worker-saturation": 1.0,  # a job that waits at a dying worker's door is suspected
            "distributed.worker.multiprocessing-method": "spawn",  # a fork of a process with Dr.Jit in it hangs
        }
        with dask.config.set(settings), _quiet():
            cluster = distributed.LocalCluster(
                n_workers=count or self.count,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address=None,
                worker_dashboard_address=None,
                scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # else its pages take port 8787
                memory_limit=self.memory_limit,
                preload=["livlab.jobs.scheduler.worker", *self.preload],
                env=dict(self.environment),
                silence_logs=logging.CRITICAL,
            )
            with cluster, distributed.Client(cluster, set_as_default=False) as client:
                yield client


@dataclass(frozen=True)
class Remote:
    """A Dask cluster that others started.

    Attributes
    ----------
    address
        Of its scheduler: tcp://HOST:PORT.
    say
        Told of workers lost and the like.
    patience
        Seconds to wait for a scheduler that was lost to come back.
    first_patience
        Seconds to wait for it to answer at first.
    """

    address: str
    say: Callable[[str], None] = _silent
    patience: float = 30.0
    first_patience: float = 10.0

    def run(self, jobs: Sequence[Job]) -> Iterator[tuple[int, Answer]]:
        """Each job's number and answer, as it ends.

        Raises
        ------
        LivlabError
            Some jobs failed; raised when all others were answered.
        EnvironmentProblem
            The same, where a machine was at fault; or no scheduler answers, or a worker has other versions.
        """
        numbers, failed = {job.digest: k for k, job in enumerate(jobs)}, list[JobOutcome]()
        left, patience = dict(numbers), self.first_patience
        while left:
            with self._connected(patience) as client, contextlib.suppress(SchedulerLost):
                outcomes = Dispatch(
                    client, [jobs[k] for k in left.values()], self.say, self.address, math.inf
                ).outcomes()
                yield from _good(outcomes, left, failed)
            if left:
                self.say(f"{self.address} was lost with {len(left)} jobs open; waiting {self.patience:.0f} s for it.")
                patience = self.patience
        _raise_failed(failed, len(jobs))

    def _connected(self, patience: float) -> AbstractContextManager[Any]:
        """A client.

        Raises
        ------
        EnvironmentProblem
            No scheduler answers in time.
        """
        _, distributed = _dask()
        limit = time.monotonic() + patience
        with _quiet():
            while True:
                try:
                    client: AbstractContextManager[Any] = distributed.Client(
                        self.address, set_as_default=False, timeout=min(10.0, patience)
                    )
                except (OSError, TimeoutError) as error:
                    if time.monotonic() < limit:
                        time.sleep(0.5)
                        continue
                    raise EnvironmentProblem(
                        f"No Dask scheduler answers at {self.address} ({type(error).__name__}).",
                        remedy="Start one (`dask scheduler`, then `dask worker` on each machine), and give the same "
                        "command again: what was done is kept.",
                    ) from None
                return client


def _good(
    outcomes: Iterator[JobOutcome], left: dict[str, int], failed: list[JobOutcome]
) -> Iterator[tuple[int, Answer]]:
    """Numbers and answers of what went well; `left` loses what is done with, `failed` gains what is not well."""
    for outcome in outcomes:
        number = left.pop(outcome.job.digest)
        if outcome.answer is None:
            failed.append(outcome)
        else:
            yield number, outcome.answer


def _raise_failed(failed: Sequence[JobOutcome], count: int) -> None:
    if not failed:
        return
    first = failed[0].error or LivlabError("It gave no answer.")
    kind = EnvironmentProblem if isinstance(first, EnvironmentProblem) else type(first)
    which = ", ".join(f"{x.job.kind} {x.job.digest[:12]}" for x in failed[:8]) + (" …" if len(failed) > 8 else "")
    told = f"{len(failed)} of {count} jobs failed ({which}); the answers of the others are kept. The first: "
    raise kind(told + first.message, remedy=first.remedy)


def _dask() -> tuple[Any, Any]:
    """The modules dask and distributed.

    Raises
    ------
    EnvironmentProblem
        One is not installed.
    """
    try:
        return importlib.import_module("dask"), importlib.import_module("distributed")
    except ImportError as error:
        raise EnvironmentProblem(
            f"Dask cannot be imported ({error}).", remedy=f"Run `{_INSTALL}`, or use --scheduler local."
        ) from None


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Dask's own log off the terminal: what the user should know is told by livlab."""
    logger = logging.getLogger("distributed")
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(before)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
