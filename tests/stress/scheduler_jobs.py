"""Kinds of job for the tests of schedulers; a worker loads this file as it starts, and a client may."""

import os
import signal
import sys
import time
import uuid
from pathlib import Path

from livlab.errors import InputError
from livlab.jobs.jobs import EVALUATORS


def nap(payload):
    """Sleep, and leave a file that says that it was begun, by whom."""
    Path(payload["log"], f"{payload['k']}-{os.getpid()}-{uuid.uuid4().hex[:8]}").touch()
    time.sleep(payload["seconds"])
    return {"k": payload["k"], "square": payload["k"] ** 2 / 7}


def gate(payload):
    """Wait for a file."""
    Path(payload["log"], f"gate-{os.getpid()}-{uuid.uuid4().hex[:8]}").touch()
    while not Path(payload["log"], "go").exists():
        time.sleep(0.02)
    return {"open": True}


def die(payload):
    """End the worker as the system does when memory is short."""
    Path(payload["log"], f"die-{os.getpid()}-{uuid.uuid4().hex[:8]}").touch()
    os.kill(os.getpid(), signal.SIGKILL)


def needy(payload):
    """What every job that walks does first."""
    from livlab.machine.llvm import choose_libllvm

    choose_libllvm()
    return {"k": payload["k"], "pid": os.getpid()}


def refuse(payload):
    """Fail on purpose, or by a fault."""
    if payload["fault"]:
        return {"never": 1 // 0}
    raise InputError.of("k", 3, "must be even", "Give 4.")


def threads(payload):
    """How many threads Dr.Jit is told to use here."""
    return {"threads": int(os.environ["LIVLAB_THREADS"]), "pid": os.getpid()}


for function in (nap, gate, die, needy, refuse, threads):
    EVALUATORS[function.__name__] = f"{Path(__file__).stem}:{function.__name__}"


def naps(log, count, seconds=0.1):
    """Jobs that each leave a trace in `log`."""
    from livlab.jobs.jobs import Job

    return [Job("nap", {"k": k, "seconds": seconds, "log": str(log)}) for k in range(count)]


def client(address, store, log, count, seconds):
    """A study in a process of its own; prints a line an answer."""
    from livlab.jobs.jobs import run_jobs
    from livlab.jobs.scheduler import Remote
    from livlab.jobs.store import Store

    kept = Store(Path(store))
    run_jobs(naps(log, count, seconds), Remote(address), kept, lambda done, total: print(done, total, flush=True))


def cluster(count):
    """A cluster in a process of its own; prints its address and ends with its standard input."""
    from livlab.jobs.scheduler import Processes

    with Processes(count, preload=(__file__,)).connected() as connected:
        print(connected.cluster.scheduler_address, flush=True)
        sys.stdin.read()


if __name__ == "__main__":
    if sys.argv[1] == "cluster":
        cluster(int(sys.argv[2]))
    else:
        client(sys.argv[2], sys.argv[3], sys.argv[4], int(sys.argv[5]), float(sys.argv[6]))
