"""An experiment in a process of its own, so that one that crashes takes nothing else with it.

It also meets the memory and the clock that `livlab run` would give it.
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import shlex
import signal
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from livlab.errors import Interrupted, LivlabError

if TYPE_CHECKING:
    from livlab.dossier.validate import Ended, Planned, Runner


def runner(base: Path, *, scheduler: str = "local", quiet: bool = False) -> Runner:
    """How `livlab.dossier.validate` runs one experiment.

    A Ctrl-C or SIGTERM here is passed on: the first lets the experiment save its batch, the second stops it at once.
    """
    from livlab.dossier.validate import Ended

    def run(one: Planned) -> Ended:
        context = multiprocessing.get_context("spawn")
        receive, send = context.Pipe(duplex=False)
        child = context.Process(target=_child, args=(send, one, base, scheduler, quiet))
        started = time.monotonic()
        with _passing_on(child) as heard:
            child.start()
            send.close()
            told = _told(receive)
            child.join()
        seconds = time.monotonic() - started
        if heard or told.get("interrupted"):
            raise Interrupted("Stopped.")
        if told.get("folder"):
            return Ended("complete", "", Path(told["folder"]), seconds, float(told["processor"]), bool(told["cached"]))
        return Ended("failed", told.get("reason") or _died(child.exitcode), None, seconds)

    return run


def _told(receive: Connection) -> dict[str, Any]:
    try:
        found = receive.recv()
    except (EOFError, OSError):
        return {}
    return found if isinstance(found, dict) else {}


def _died(code: int | None) -> str:
    """Why a process ended that said nothing.

    >>> _died(-6)
    'its process was ended by SIGABRT'
    """
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        return f"its process was ended by {name}" + (" (out of memory?)" if name == "SIGKILL" else "")
    return f"its process ended with status {code} and said nothing"


@contextmanager
def _passing_on(child: Any) -> Iterator[list[int]]:
    """Pass SIGINT and SIGTERM on to the child; gives what was heard."""
    heard: list[int] = []

    def hear(number: int, _frame: FrameType | None) -> None:
        heard.append(number)
        if child.pid is not None and child.is_alive():
            os.kill(child.pid, number)

    old = {number: signal.signal(number, hear) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield heard
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)


def _child(send: Connection, one: Planned, base: Path, scheduler: str, quiet: bool) -> None:
    os.setsid()  # a terminal's Ctrl-C comes once, through the parent
    try:
        send.send(_run(one, base, scheduler, quiet))
    except (Interrupted, KeyboardInterrupt):
        send.send({"interrupted": True})
    except LivlabError as error:
        send.send({"reason": f"{error.message} {error.remedy}".strip()})
    except BaseException as error:  # whatever one experiment does, the dossier says it
        traceback.print_exc()
        send.send({"reason": f"{type(error).__name__}: {error}"})


def _run(one: Planned, base: Path, scheduler: str, quiet: bool) -> dict[str, Any]:
    from livlab.cli.progress import watched
    from livlab.config.kinds import KINDS
    from livlab.kinds.execute import execute

    assert one.config is not None
    has_jobs = KINDS[one.config.plain()["kind"]].jobs
    options = ["--out", str(base)] if base != Path("runs") else []
    with watched(one.title, quiet=quiet) as progress:
        outcome = execute(
            one.config,
            base=base,
            command=shlex.join(["livlab", "run", _named(one.path), *options]),
            progress=progress,
            scheduler=scheduler if has_jobs else "local",
        )
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    processor = sum(u.ru_utime + u.ru_stime for u in used)
    return {"folder": str(outcome.folder), "cached": outcome.cached, "processor": processor}


def _named(path: Path) -> str:
    """How a user would name the file: livlab's own by its name, so that no machine's folder gets into a manifest."""
    from livlab.config.load import builtin_experiments

    return path.stem if builtin_experiments().get(path.stem) == path else str(path)
