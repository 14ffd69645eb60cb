"""What becomes of a study when workers, the client or the scheduler die; all on the loopback interface."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path

import psutil
import pytest
import scheduler_jobs
from scheduler_jobs import naps

pytest.importorskip("distributed")

from livlab.errors import EnvironmentProblem, LivlabError
from livlab.jobs.jobs import Job, MemoryStore, run_jobs
from livlab.jobs.scheduler import Processes, Remote
from livlab.jobs.store import Store

SCRIPT = str(Path(scheduler_jobs.__file__))
WORKERS = 2


@pytest.fixture(scope="module")
def cluster():
    """Two workers; the client of it serves to look at them, not to send jobs."""
    before = {p.pid for p in psutil.Process().children(recursive=True)}
    with Processes(WORKERS, preload=(SCRIPT,)).connected() as client:
        yield client
    left = [
        p
        for p in psutil.Process().children(recursive=True)
        if p.pid not in before and "resource_tracker" not in " ".join(p.cmdline())
    ]
    assert left == []


@pytest.fixture
def address(cluster):
    cluster.wait_for_workers(WORKERS, timeout=60)  # a test before may have killed some
    return cluster.cluster.scheduler_address


@pytest.fixture
def log(tmp_path):
    folder = tmp_path / "log"
    folder.mkdir()
    return folder


def begun(log):
    """How often each job was begun."""
    return Counter(path.name.split("-")[0] for path in log.iterdir())


def pids(client):
    return {said["pid"] for said in client.run(facts_of_worker).values()}


def facts_of_worker():
    from livlab.jobs.scheduler.worker import facts

    return facts()


def wait_for(condition, seconds=60.0):
    limit = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < limit, "it never came to that"
        time.sleep(0.02)


def test_a_cluster_gives_what_this_process_gives(address, log):
    jobs = naps(log, 12, 0.0)
    assert run_jobs(jobs[::-1], Remote(address)) == run_jobs(jobs)[::-1]
    assert set(begun(log).values()) == {2}


def test_nothing_listens_beyond_the_loopback_interface(cluster, address):
    family = [psutil.Process(), *(psutil.Process(pid) for pid in pids(cluster))]
    listening = [c.laddr for p in family for c in p.net_connections("inet") if c.status == psutil.CONN_LISTEN]
    assert len(listening) >= 1 + WORKERS
    assert {place.ip for place in listening} == {"127.0.0.1"}
    assert 8787 not in {place.port for place in listening}


def test_the_cores_are_shared_among_the_workers(address):
    said = run_jobs([Job("threads", {"k": k}) for k in range(8)], Remote(address))
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    assert {x["threads"] for x in said} == {max(1, cores // WORKERS)}


def test_a_worker_killed_in_mid_study_costs_its_own_jobs_only(cluster, address, log):
    said, killed = [], []

    def progress(done, total):
        if done == 4 and not killed:
            killed.append(min(pids(cluster)))
            os.kill(killed[0], signal.SIGKILL)

    jobs = naps(log, 16, 0.2)
    assert [x["k"] for x in run_jobs(jobs, Remote(address, said.append), None, progress)] == list(range(16))
    counts = begun(log)
    assert killed and len(counts) == 16
    again = [k for k, n in counts.items() if n > 1]
    assert len(again) <= 2  # the one at work, and one whose answer lay with the dead worker
    assert any("lost" in text for text in said)


def test_a_job_that_always_kills_is_named_and_the_others_finish(address, log):
    bad = Job("die", {"log": str(log)})
    jobs = naps(log, 10)
    store = MemoryStore()
    with pytest.raises(LivlabError, match=f"1 of 11 jobs failed .*{bad.digest}"):
        run_jobs([*jobs[:3], bad, *jobs[3:]], Remote(address), store)
    assert set(store.answers) == {job.digest for job in jobs}
    assert 2 <= begun(log)["die"] <= 4


def test_failures_are_told_and_the_others_finish(address, log):
    jobs = [Job("refuse", {"fault": False}), *naps(log, 4, 0.0), Job("refuse", {"fault": True})]
    store = MemoryStore()
    with pytest.raises(LivlabError, match=r"2 of 6 jobs failed .*(must be even|ZeroDivisionError at scheduler_jobs)"):
        run_jobs(jobs, Remote(address), store)
    assert len(store.answers) == 4


def test_two_studies_take_turns(address, log):
    jobs, ended, answers = naps(log, 24, 0.1), {}, {}

    def study(name, part):
        answers[name] = run_jobs(
            part, Remote(address), None, lambda done, total: ended.setdefault((name, done), time.monotonic())
        )

    parts = {"a": jobs[:16], "b": jobs[8:]}
    both = [threading.Thread(target=study, args=item) for item in parts.items()]
    for thread in both:
        thread.start()
    for thread in both:
        thread.join(90)
    assert {name: [x["k"] for x in found] for name, found in answers.items()} == {
        "a": list(range(16)),
        "b": list(range(8, 24)),
    }
    assert ended["a", 1] < ended["b", 16] and ended["b", 1] < ended["a", 16]
    counts = begun(log)
    assert len(counts) == 24
    assert all(counts[str(k)] == 1 for k in [*range(8), *range(16, 24)])


def test_a_job_that_two_studies_have_in_hand_is_done_once(cluster, address, log):
    job, answers = Job("gate", {"log": str(log)}), []
    both = [threading.Thread(target=lambda: answers.extend(run_jobs([job], Remote(address)))) for _ in range(2)]
    for thread in both:
        thread.start()
    tasks = cluster.cluster.scheduler.tasks
    wait_for(lambda: any(len(task.who_wants) == 2 for task in list(tasks.values())))
    (log / "go").touch()
    for thread in both:
        thread.join(60)
    assert answers == [{"open": True}] * 2
    assert begun(log)["gate"] == 1


def test_a_client_killed_goes_on_where_it_stopped(address, tmp_path, log):
    command = [sys.executable, SCRIPT, "client", address, str(tmp_path / "store"), str(log), "14", "0.2"]
    first = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert first.stdout is not None
    while not first.stdout.readline().startswith("5 "):
        assert first.poll() is None
    first.kill()
    first.wait()
    first.stdout.close()
    kept = {path.stem: path.stat().st_mtime_ns for path in (tmp_path / "store").rglob("[0-9a-f]*.json")}
    assert 5 <= len(kept) < 14
    jobs = naps(log, 14, 0.2)
    before = begun(log)
    in_flight = {str(j.payload["k"]) for j in jobs if j.digest not in kept} & set(before)
    found = run_jobs(jobs, Remote(address), Store(tmp_path / "store"))
    assert [x["k"] for x in found] == list(range(14))
    after = {path.stem: path.stat().st_mtime_ns for path in (tmp_path / "store").rglob("[0-9a-f]*.json")}
    assert {digest: after[digest] for digest in kept} == kept  # nothing kept was done again
    assert len(in_flight) <= 2 * WORKERS
    counts = begun(log)
    assert {k for k, n in counts.items() if n > 1} <= {str(j.payload["k"]) for j in jobs if j.digest not in kept}
    assert sum(counts.values()) <= 14 + 2 * WORKERS


def test_a_scheduler_lost_keeps_what_was_done(address, tmp_path, log):
    other = subprocess.Popen(
        [sys.executable, SCRIPT, "cluster", "1"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert other.stdout is not None and other.stdin is not None
    where = other.stdout.readline().strip()
    workers = [p for p in psutil.Process(other.pid).children(recursive=True) if "spawn_main" in " ".join(p.cmdline())]
    said, store, jobs = [], Store(tmp_path / "store"), naps(log, 8, 0.1)

    def progress(done, total):
        if done == 3:
            other.kill()

    with pytest.raises(EnvironmentProblem, match=r"No Dask scheduler answers at tcp://127\.0\.0\.1"):
        run_jobs(jobs, Remote(where, said.append, patience=1.0), store, progress)
    other.wait()
    other.stdin.close()
    other.stdout.close()
    assert any("was lost with" in text for text in said)
    kept = [job for job in jobs if store.load(job.digest) is not None]
    assert 3 <= len(kept) < 8
    assert len(begun(log)) <= len(kept) + 2
    wait_for(lambda: not any(p.is_running() and p.status() != psutil.STATUS_ZOMBIE for p in workers))
    assert [x["k"] for x in run_jobs(jobs, Remote(address), store)] == list(range(8))
    counts = begun(log)
    assert all(counts[str(job.payload["k"])] == 1 for job in kept)


def test_jobs_go_round_a_worker_without_llvm_and_back_if_there_is_no_other(libllvm, tmp_path, log):
    lame = Processes(1, preload=(SCRIPT,), environment=(("DRJIT_LIBLLVM_PATH", str(tmp_path / "none.so")),))
    jobs = [Job("needy", {"k": k}) for k in range(4)]
    with lame.connected() as client:
        where = client.cluster.scheduler_address
        store = MemoryStore()
        with pytest.raises(
            EnvironmentProblem, match=r"4 of 7 jobs failed .*worker tcp://127.0.0.1:\d+ on .*none\.so"
        ) as told:
            run_jobs([*jobs, *naps(log, 3, 0.0)], Remote(where), store)
        assert "DRJIT_LIBLLVM_PATH" in told.value.remedy or "libllvm" in told.value.remedy
        assert len(store.answers) == 3
        (bad,) = pids(client)
        environment = {**os.environ, "DRJIT_LIBLLVM_PATH": str(libllvm)}
        command = [sys.executable, "-m", "dask", "worker", where, "--nthreads", "1", "--no-dashboard", "--no-nanny"]
        good = subprocess.Popen(
            [*command, "--host", "127.0.0.1", "--preload", SCRIPT], env=environment, stderr=subprocess.DEVNULL
        )
        try:
            client.wait_for_workers(2, timeout=60)
            said = []
            found = run_jobs(jobs, Remote(where, said.append))
            assert {x["pid"] for x in found} == {good.pid} and good.pid != bad
            assert len(said) <= 1  # told once, not per job
        finally:
            good.terminate()
            good.wait(30)


def test_another_version_is_refused(address, log, monkeypatch):
    from livlab.jobs.scheduler import worker

    monkeypatch.setattr(worker, "__version__", "99.0")
    with pytest.raises(EnvironmentProblem, match=r"Worker tcp://.* has livlab .*this client livlab 99\.0"):
        run_jobs(naps(log, 2), Remote(address))
    assert not begun(log)


def test_nobody_answers():
    with pytest.raises(EnvironmentProblem, match=r"No Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        list(Remote("tcp://127.0.0.1:9", first_patience=0.5).run(naps("", 1)))
