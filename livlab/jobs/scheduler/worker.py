"""What a worker does: say who it is, share the cores with its neighbours, and turn a job's text into an answer's text.

A worker gets and gives strings of JSON, so that no object of ours is ever pickled.
"""

from __future__ import annotations

import json
import os
import platform
import signal
import threading
import traceback
from pathlib import Path
from typing import Any

from livlab.errors import EnvironmentProblem, LivlabError
from livlab.jobs.jobs import ANSWER_VERSION, Job, run_job
from livlab.machine.llvm import THREADS
from livlab.machine.version import __version__

_SETTLED = "LIVLAB_THREADS_SETTLED"


def versions() -> dict[str, Any]:
    """What must agree between client and worker for their numbers to agree."""
    from livlab.runs.identity import RESULT_VERSION

    return {"livlab": __version__, "result": RESULT_VERSION, "answer": ANSWER_VERSION}


def dask_setup(_worker: object) -> None:
    """Outlive a Ctrl-C, which a terminal sends to all processes: the client ends this one when it has what it wants."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def facts() -> dict[str, Any]:
    """Who this process is: its versions, host, process id, and the cores that it may use."""
    return {"versions": versions(), "host": platform.node(), "pid": os.getpid(), "cores": sorted(_cores())}


def settle(threads: int) -> int:
    """Keep Dr.Jit to a number of threads in this process, unless its owner has said one; returns what holds."""
    if THREADS not in os.environ or os.environ.get(_SETTLED):
        os.environ[THREADS] = os.environ[_SETTLED] = str(threads)
    return int(os.environ[THREADS])


def parcel(job: Job) -> str:
    """A job as it travels: JSON of its kind, its payload and the versions that the client has."""
    return json.dumps({"kind": job.kind, "payload": job.payload, "versions": versions()}, sort_keys=True)


def work(parcel: str) -> str:
    """Compute a job on a worker.

    Returns
    -------
    JSON with "by", the worker's address, and one of: "result"; "refused" (the worker's versions, where they differ);
    "lacking" (this machine cannot do it, another may); "failed" (it fails anywhere). The last two hold class, message
    and remedy.
    """
    return json.dumps({"by": _address(), **_worked(json.loads(parcel))})


def _worked(said: dict[str, Any]) -> dict[str, Any]:
    if said["versions"] != versions():
        return {"refused": versions()}
    try:
        return {"result": run_job(Job(said["kind"], said["payload"]))}
    except EnvironmentProblem as problem:
        return {"lacking": _told(problem)}
    except LivlabError as error:
        return {"failed": _told(error)}
    except Exception as error:
        # A fault of ours: its place is worth telling, and the other jobs go on.
        frame = traceback.extract_tb(error.__traceback__)[-1]
        message = f"{type(error).__name__} at {Path(frame.filename).name}:{frame.lineno}: {error}"
        return {"failed": {"class": "LivlabError", "message": message, "remedy": ""}}


def _address() -> str:
    from distributed import get_worker

    try:
        return str(get_worker().address)
    except ValueError:
        return "this process"


def _told(error: LivlabError) -> dict[str, str]:
    return {"class": type(error).__name__, "message": error.message, "remedy": error.remedy}


def _cores() -> set[int]:
    return os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set(range(os.cpu_count() or 1))
