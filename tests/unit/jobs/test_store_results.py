"""Results by content: whole or not there, checked when read, shared where a folder is shared."""

import json
import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from livlab.errors import EnvironmentProblem, InputError
from livlab.jobs.jobs import Job, run_jobs
from livlab.jobs.store import Store, store_of

DIGEST = Job("spectrum", {"a": 1}).digest
ANSWER = {"value": [0.1, 1 / 3, 5e-324], "notes": ["é", '"'], "error": None}


def test_what_was_saved_is_loaded(tmp_path):
    store = Store(tmp_path / "jobs")
    assert store.load(DIGEST) is None
    store.save(DIGEST, ANSWER)
    assert store.load(DIGEST) == ANSWER
    assert [path.name for path in (tmp_path / "jobs").rglob("*") if path.is_file()] == [f"{DIGEST}.json"]
    assert store.notes == []


json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(answer=st.dictionaries(st.text(), json_values, max_size=4))
def test_any_json_comes_back_exactly(tmp_path_factory, answer):
    store = Store(tmp_path_factory.getbasetemp() / "any")
    store.save(DIGEST, answer)
    assert store.load(DIGEST) == answer
    assert store.notes == []


@pytest.mark.parametrize("at", [0, 10, 90, -30, -3])
def test_one_bit_turned_is_found_and_the_job_done_again(tmp_path, at):
    store = Store(tmp_path)
    store.save(DIGEST, ANSWER)
    path = store.path(DIGEST)
    raw = bytearray(path.read_bytes())
    raw[at] ^= 1
    path.write_bytes(raw)
    assert store.load(DIGEST) is None
    assert "damaged" in store.notes[0] and DIGEST[:12] in store.notes[0]
    assert not path.exists()
    store.save(DIGEST, ANSWER)
    assert store.load(DIGEST) == ANSWER


@pytest.mark.parametrize("text", ["", "{}", "[]", "null", "not json", "\udcff"])
def test_a_file_that_is_none_of_ours_is_found(tmp_path, text):
    store = Store(tmp_path)
    store.path(DIGEST).parent.mkdir()
    store.path(DIGEST).write_bytes(text.encode("utf-8", "surrogateescape"))
    assert store.load(DIGEST) is None
    assert len(store.notes) == 1


def test_a_cut_file_is_found(tmp_path):
    store = Store(tmp_path)
    store.save(DIGEST, ANSWER)
    os.truncate(store.path(DIGEST), store.path(DIGEST).stat().st_size // 2)
    assert store.load(DIGEST) is None


def test_the_result_of_another_job_is_not_taken(tmp_path):
    store, other = Store(tmp_path), Job("spectrum", {"a": 2}).digest
    store.save(DIGEST, ANSWER)
    store.path(other).parent.mkdir(exist_ok=True)
    store.path(DIGEST).rename(store.path(other))
    assert store.load(other) is None


def test_a_changed_version_is_another_result_and_no_damage(tmp_path):
    Store(tmp_path, versions={"result": 1}).save(DIGEST, ANSWER)
    newer = Store(tmp_path, versions={"result": 2})
    assert newer.load(DIGEST) is None
    assert newer.notes == [] and newer.path(DIGEST).exists()
    assert Store(tmp_path, versions={"result": 1}).load(DIGEST) == ANSWER


def test_a_forged_version_is_damage(tmp_path):
    store = Store(tmp_path, versions={"result": 1})
    store.save(DIGEST, ANSWER)
    said = json.loads(store.path(DIGEST).read_text())
    store.path(DIGEST).write_text(json.dumps({**said, "versions": {"result": 2}}))
    newer = Store(tmp_path, versions={"result": 2})
    assert newer.load(DIGEST) is None
    assert "hash differs" in newer.notes[0]


def test_runs_share_a_folder(tmp_path):
    first = Store(tmp_path / "a", shared=tmp_path / "all")
    first.save(DIGEST, ANSWER)
    second = Store(tmp_path / "b", shared=tmp_path / "all")
    assert second.load(DIGEST) == ANSWER
    assert second.path(DIGEST).exists()  # its own from now on, should the shared one go
    fresh = Store(tmp_path / "c", shared=tmp_path / "all", trust_shared=False)
    assert fresh.load(DIGEST) is None


def test_a_damaged_shared_result_is_renewed(tmp_path):
    store = Store(tmp_path / "a", shared=tmp_path / "all")
    store.save(DIGEST, ANSWER)
    store.path(DIGEST, tmp_path / "all").write_text("{}")
    second = Store(tmp_path / "b", shared=tmp_path / "all")
    assert second.load(DIGEST) is None
    second.save(DIGEST, ANSWER)
    assert Store(tmp_path / "c", shared=tmp_path / "all").load(DIGEST) == ANSWER


def test_a_shared_folder_that_cannot_be_written_costs_a_note(tmp_path):
    (tmp_path / "all").write_text("a file stands here")
    store = Store(tmp_path / "a", shared=tmp_path / "all")
    assert store.load(DIGEST) is None
    store.save(DIGEST, ANSWER)
    store.save(Job("spectrum", {"a": 2}).digest, ANSWER)
    assert store.load(DIGEST) == ANSWER
    assert any("in this run alone" in note for note in store.notes)


def test_a_folder_that_cannot_be_written_is_told(tmp_path):
    (tmp_path / "jobs").write_text("a file stands here")
    with pytest.raises(EnvironmentProblem, match="Cannot write"):
        Store(tmp_path / "jobs").save(DIGEST, ANSWER)


@pytest.mark.parametrize("digest", ["", "../../etc/passwd", "AB" * 32, "a" * 63, "a" * 65, "a" * 64 + "\n"])
def test_what_is_no_digest_is_no_path(tmp_path, digest):
    with pytest.raises(InputError, match="64 hexadecimal"):
        Store(tmp_path).load(digest)


@pytest.mark.parametrize("answer", [{"x": object()}, {"x": {1, 2}}, {("a", 1): 2}])
def test_what_is_not_json_is_refused(tmp_path, answer):
    with pytest.raises(InputError, match="must be JSON"):
        Store(tmp_path).save(DIGEST, answer)
    assert not list(tmp_path.rglob("*.json"))


def test_a_damaged_result_is_computed_again_and_the_rest_found(tmp_path):
    asked = []

    class Counting:
        def run(self, jobs):
            asked.append(len(jobs))
            yield from ((k, {"a": job.payload["a"]}) for k, job in enumerate(jobs))

    jobs, store = [Job("spectrum", {"a": k}) for k in range(6)], Store(tmp_path)
    first = run_jobs(jobs, Counting(), store)
    path = store.path(jobs[2].digest)
    path.write_bytes(path.read_bytes().replace(b'"a":2', b'"a":9'))
    assert run_jobs(jobs, Counting(), store) == first
    assert asked == [6, 1]


def test_a_forced_run_takes_nothing_from_the_shared_folder(tmp_path):
    class FakeRun:
        folder, shared, again = tmp_path / "run", tmp_path / "all", True

    Store(tmp_path / "x", tmp_path / "all", store_of(FakeRun()).versions).save(DIGEST, ANSWER)
    assert store_of(FakeRun()).load(DIGEST) is None
    FakeRun.again = False
    assert store_of(FakeRun()).load(DIGEST) == ANSWER
    assert (tmp_path / "run" / ".pieces" / "jobs").is_dir()
