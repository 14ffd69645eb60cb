"""--scheduler's forms, what a worker answers, and what is said where Dask is missing; no cluster is started."""

import json
import os
import sys

import pytest
from typer.testing import CliRunner

from livlab.cli.app import app
from livlab.errors import DatasetError, EnvironmentProblem, InputError, LivlabError
from livlab.jobs import jobs as jobs_module
from livlab.jobs.jobs import Job, LocalScheduler
from livlab.jobs.scheduler import Processes, Remote, _raise_failed, dispatch, open_scheduler, worker
from livlab.jobs.scheduler.dispatch import JobOutcome

WRONG = [
    "", "processes:0", "processes:-1", "processes:x", "processes:1025", "processes: 2", "tcp://", "tcp://host",
    "tcp://host:0", "tcp://host:70000", "udp://host:1", "LOCAL", "tcp://a b:1", "tcp://host:1/x",
]  # fmt: skip


@pytest.mark.parametrize("text", WRONG)
def test_a_slip_is_told(text):
    with pytest.raises(InputError, match=r"--scheduler = .*must be a scheduler") as told:
        open_scheduler(text)
    assert "processes:N" in told.value.remedy


def test_the_forms():
    pytest.importorskip("distributed")
    assert isinstance(open_scheduler(), LocalScheduler)
    assert open_scheduler("processes:3") == Processes(3)
    assert open_scheduler("processes").count >= 1
    for address in ("tcp://127.0.0.1:8786", "tcp://node-1.cluster:1", "tcp://[::1]:65535"):
        assert open_scheduler(address) == Remote(address)


@pytest.mark.parametrize("text", ["processes:2", "tcp://127.0.0.1:8786"])
@pytest.mark.parametrize("missing", ["dask", "distributed"])
def test_without_dask_the_command_is_said(monkeypatch, text, missing):
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(EnvironmentProblem, match="Dask cannot be imported") as told:
        open_scheduler(text)
    assert "pip install 'livlab[distributed]'" in told.value.remedy


def test_local_needs_no_dask(monkeypatch):
    monkeypatch.setitem(sys.modules, "dask", None)
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert isinstance(open_scheduler("local"), LocalScheduler)


def test_a_slip_is_told_before_anything_runs(tmp_path):
    done = CliRunner().invoke(app, ["run", "readings", "--scheduler", "processes:none", "--out", str(tmp_path)])
    assert isinstance(done.exception, InputError)
    assert "--scheduler" in str(done.exception)
    assert not list(tmp_path.iterdir())


@pytest.fixture
def kinds(monkeypatch):
    """Kinds of job that answer, fail, or find the machine wanting."""

    def answer(payload):
        return {"twice": 2 * payload["x"]}

    def fail(payload):
        raise DatasetError("No such thing.", remedy="Name another.")

    def lack(payload):
        raise EnvironmentProblem("No libLLVM.", remedy="Install one.")

    def fault(payload):
        return {"never": [][payload["x"]]}

    for function in (answer, fail, lack, fault):
        monkeypatch.setattr(sys.modules[__name__], f"job_{function.__name__}", function, raising=False)
        monkeypatch.setitem(jobs_module.EVALUATORS, function.__name__, f"{__name__}:job_{function.__name__}")


@pytest.mark.parametrize(
    ("kind", "key", "said"),
    [
        ("answer", "result", {"twice": 6}),
        ("fail", "failed", {"class": "DatasetError", "message": "No such thing.", "remedy": "Name another."}),
        ("lack", "lacking", {"class": "EnvironmentProblem", "message": "No libLLVM.", "remedy": "Install one."}),
    ],
)
def test_a_worker_answers_in_json(kinds, kind, key, said):
    told = json.loads(worker.work(worker.parcel(Job(kind, {"x": 3}))))
    assert told[key] == said
    assert set(told) == {"by", key}


def test_a_fault_tells_its_place(kinds):
    told = json.loads(worker.work(worker.parcel(Job("fault", {"x": 3}))))["failed"]
    assert told["message"].startswith("IndexError at test_scheduler_forms.py:")


@pytest.mark.parametrize("key", ["livlab", "result", "answer"])
def test_a_worker_of_another_version_refuses(kinds, monkeypatch, key):
    sent = json.loads(worker.parcel(Job("answer", {"x": 3})))
    sent["versions"][key] = "other"
    told = json.loads(worker.work(json.dumps(sent)))
    assert told["refused"] == worker.versions()
    assert "result" not in told


@pytest.mark.parametrize("name", ["InputError", "DatasetError", "EnvironmentProblem"])
def test_an_error_keeps_its_class(name):
    error = dispatch._error({"class": name, "message": "m", "remedy": "r"})
    assert (type(error).__name__, error.message, error.remedy) == (name, "m", "r")


@pytest.mark.parametrize("name", ["annotations", "SystemExit", "nonsense"])
def test_an_unknown_class_is_livlabs_own(name):
    assert type(dispatch._error({"class": name, "message": "m", "remedy": ""})) is LivlabError


def test_failures_are_counted_and_named():
    failed = [JobOutcome(Job("answer", {"x": k}), None, InputError("bad", remedy="mend")) for k in range(9)]
    with pytest.raises(InputError, match=r"9 of 20 jobs failed \(answer [0-9a-f]{12}, .* …\).*The first: bad") as told:
        _raise_failed(failed, 20)
    assert told.value.remedy == "mend"


def test_an_owner_s_number_of_threads_is_kept(monkeypatch):
    for name in ("LIVLAB_THREADS", "LIVLAB_THREADS_SETTLED"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    assert worker.settle(3) == 3
    assert worker.settle(2) == 2  # neighbours come and go
    monkeypatch.delenv("LIVLAB_THREADS_SETTLED")
    assert worker.settle(5) == 2
    assert os.environ["LIVLAB_THREADS"] == "2"


def test_seeds_and_digests_depend_on_content_alone():
    a, b = Job("spectrum", {"x": 1, "y": [0.1, 2]}), Job("spectrum", {"y": [0.1, 2], "x": 1})
    assert worker.parcel(a) == worker.parcel(b)
    assert a.digest == b.digest != Job("spectrum", {"x": 1, "y": [0.1, 3]}).digest


@pytest.mark.parametrize("value", ["0", "-1", "two", "1e3", " 2", "99999"])
def test_a_number_of_threads_that_is_none_is_told(monkeypatch, value):
    from livlab.model.transport.device import limit_threads

    monkeypatch.setenv("LIVLAB_THREADS", value)
    with pytest.raises(EnvironmentProblem, match="is no number of threads"):
        limit_threads(None)


def test_dr_jit_keeps_to_the_number_of_threads(monkeypatch):
    from livlab.model.transport.device import limit_threads

    class FakeDrJit:
        count = 8

        def thread_count(self):
            return self.count

        def set_thread_count(self, count):
            self.count = count

    engine = FakeDrJit()
    monkeypatch.delenv("LIVLAB_THREADS", raising=False)
    limit_threads(engine)
    assert engine.count == 8
    monkeypatch.setenv("LIVLAB_THREADS", "3")
    limit_threads(engine)
    assert engine.count == 3
