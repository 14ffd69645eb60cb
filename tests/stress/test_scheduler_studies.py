"""A real study through the command line: the same numbers anywhere; `kill -9` costs what was in flight."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

pytest.importorskip("distributed")

from livlab.config import load_experiment
from livlab.errors import EnvironmentProblem
from livlab.jobs.jobs import Job, MemoryStore, run_jobs
from livlab.jobs.scheduler import Processes
from livlab.kinds.study import sweep

POINTS = 10
STUDY = f"""
schema = 1
kind = "study"
method = "sweep"
name = "faults"
seed = 3
[tissue]
preset = "liver"
[wavelengths]
start_nm = 500
stop_nm = 700
step_nm = 100
[instrument]
kind = "collinear"
[solver]
kind = "walk"
samples = 20000
pilot = 2000
[[factor]]
path = "layers.parenchyma.elements.blood.fraction"
low = 0.02
high = 0.15
count = {POINTS}
[[output]]
metric = "mean"
[sweep]
"""


def livlab(folder, *options):
    (folder / "faults.toml").write_text(STUDY)
    command = [
        sys.executable,
        "-c",
        "from livlab.cli import main; main()",
        "run",
        str(folder / "faults.toml"),
        "--no-report",
        *options,
    ]
    # A session of its own: a Ctrl-C can be sent to all of it, as a terminal does.
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True)


def finished(process):
    said = process.communicate(timeout=300)[0].decode()
    assert process.returncode == 0, said
    return said


def numbers(runs):
    (folder,) = runs.iterdir()
    with (folder / "results.csv").open() as stream:
        return [{k: v for k, v in row.items() if "seconds" not in k} for row in csv.DictReader(stream)]


def results(folder):
    """Time of each result; what a killed process was just writing has a name that begins with a dot."""
    return {path.stem: path.stat().st_mtime_ns for path in folder.rglob("[0-9a-f]*.json") if len(path.stem) == 64}


@pytest.mark.slow
def test_kill_9_of_the_client_and_all_it_started(libllvm, tmp_path):
    here, there, shared = tmp_path / "here", tmp_path / "there", tmp_path / "shared"
    finished(livlab(tmp_path, "--out", str(here)))
    first = livlab(tmp_path, "--out", str(there), "--store", str(shared), "--scheduler", "processes:2")
    limit = time.monotonic() + 200
    while len(results(there)) < 3:
        assert first.poll() is None and time.monotonic() < limit
        time.sleep(0.02)
    children = psutil.Process(first.pid).children(recursive=True)
    first.kill()
    first.communicate()
    done = results(there)
    assert 3 <= len(done) < POINTS
    _, left = psutil.wait_procs(children, timeout=30)
    assert [p for p in left if p.status() != psutil.STATUS_ZOMBIE] == []  # nobody goes on alone
    renewed = results(shared)
    assert len(done.keys() - renewed.keys()) <= 1  # the kill may fall between the two folders
    assert renewed.keys() <= done.keys()
    finished(livlab(tmp_path, "--out", str(there), "--store", str(shared), "--scheduler", "processes:3"))
    after = results(shared)
    assert {stem: after[stem] for stem in renewed} == renewed  # what was kept was not done again
    assert renewed.keys() <= after.keys() and len(after.keys() | done.keys()) == POINTS
    assert numbers(there) == numbers(here)
    assert not results(there)  # pieces are dropped when all is done


@pytest.mark.slow
def test_ctrl_c_of_the_whole_terminal_keeps_what_is_done(libllvm, tmp_path):
    study = livlab(tmp_path, "--out", str(tmp_path / "runs"), "--scheduler", "processes:2")
    limit = time.monotonic() + 200
    while len(results(tmp_path / "runs")) < 2:
        assert study.poll() is None and time.monotonic() < limit
        time.sleep(0.02)
    children = psutil.Process(study.pid).children(recursive=True)
    os.killpg(study.pid, signal.SIGINT)
    said = study.communicate(timeout=60)[0].decode()
    assert study.returncode == 130, said
    assert "--scheduler processes:2" in said and "Traceback" not in said and "lost" not in said
    _, left = psutil.wait_procs(children, timeout=30)
    assert left == []
    done = results(tmp_path / "runs")
    assert 3 <= len(done) < POINTS
    assert "Traceback" not in finished(livlab(tmp_path, "--out", str(tmp_path / "runs")))
    assert len(numbers(tmp_path / "runs")) == POINTS


@pytest.mark.slow
def test_the_same_numbers_with_any_number_of_workers(libllvm, tmp_path):
    found = []
    for name in ("local", "processes:1", "processes:3"):
        runs = tmp_path / name.replace(":", "")
        finished(livlab(tmp_path, "--out", str(runs), "--scheduler", name))
        found.append(numbers(runs))
        manifest = json.loads(next(runs.glob("*/manifest.json")).read_text())
        assert manifest["scheduler"] == name
    assert len(found[0]) == POINTS
    assert found[0] == found[1] == found[2]


@pytest.mark.slow
def test_two_workers_killed_in_a_real_study(libllvm, tmp_path):
    here, there = tmp_path / "here", tmp_path / "there"
    finished(livlab(tmp_path, "--out", str(here)))
    study = livlab(tmp_path, "--out", str(there), "--scheduler", "processes:2")
    for wanted in (2, 5):
        limit = time.monotonic() + 200
        while len(results(there)) < wanted:
            assert study.poll() is None and time.monotonic() < limit
            time.sleep(0.02)
        workers = [p for p in psutil.Process(study.pid).children() if "spawn_main" in " ".join(p.cmdline())]
        workers[0].send_signal(signal.SIGKILL)
    said = finished(study)
    assert "lost; their jobs are given out again" in said
    assert numbers(there) == numbers(here)


@pytest.mark.slow
def test_a_worker_without_llvm_does_what_needs_none(tmp_path):
    (tmp_path / "faults.toml").write_text(STUDY)
    config = load_experiment(tmp_path / "faults.toml")
    payload = dict(sweep.jobs_of(config, sweep.sweep_points(config)[:1], {})[0].payload)
    walk = Job("spectrum", payload)
    exact = Job(
        "spectrum", {**payload, "solver": {"kind": "adding-doubling"}, "instrument": {"kind": "integrating-sphere"}}
    )
    (local,) = run_jobs([exact])
    assert "value" in local
    lame, store = Processes(1, environment=(("DRJIT_LIBLLVM_PATH", str(Path(tmp_path, "none.so"))),)), MemoryStore()
    with pytest.raises(EnvironmentProblem, match=r"1 of 2 jobs failed .*worker tcp://127.*none\.so") as told:
        run_jobs([walk, exact], lame, store)
    assert told.value.remedy
    assert store.answers.keys() == {exact.digest}
    # Not bit for bit: OpenBLAS adds in another order with one thread (a worker's) than with many.
    assert store.answers[exact.digest]["value"] == pytest.approx(local["value"], rel=1e-13)
