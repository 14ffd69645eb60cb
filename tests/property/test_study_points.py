"""Points of studies: what must hold of any design, any factor and any job."""

import json

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from livlab.jobs.jobs import Job, MemoryStore, run_jobs
from livlab.kinds.study.config_parts import Factor, Sensitivity
from livlab.kinds.study.sensitivity import unit_design
from livlab.kinds.study.sweep import mapped, unit_points

SETTINGS = settings(max_examples=40, deadline=None, derandomize=True)
PLAIN = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(10**6), 10**6)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


@SETTINGS
@given(st.sampled_from(["sobol", "latin-hypercube"]), st.integers(1, 6), st.integers(2, 90), st.integers(0, 10**6))
def test_designs_lie_in_the_cube_and_repeat(design, dimensions, count, seed):
    u = unit_points(design, dimensions, count, seed)
    assert u.shape == (count, dimensions)
    assert (u >= 0).all()
    assert (u < 1).all()
    assert np.array_equal(u, unit_points(design, dimensions, count, seed))
    if design == "latin-hypercube":
        assert all(sorted((count * column).astype(int)) == list(range(count)) for column in u.T)


@SETTINGS
@given(st.integers(1, 5), st.integers(3, 6), st.integers(0, 10**6))
def test_each_saltelli_block_changes_one_factor_at_a_time(factors, power, seed):
    spec = Sensitivity(points=2**power)
    blocks = unit_design(spec, factors, seed).reshape(2**power, factors + 2, factors)
    for block in blocks:
        for k in range(factors):
            off = block[k + 1] != block[0]
            assert not off[np.arange(factors) != k].any()
            assert block[k + 1][k] == block[-1][k]


@SETTINGS
@given(st.floats(1e-6, 1e3), st.floats(1.01, 1e4), st.sampled_from(["linear", "log"]), st.floats(0, 1), st.floats(0, 1))
def test_a_factor_rises_between_its_bounds(low, ratio, transform, a, b):
    f = Factor(path="x", low=low, high=low * ratio, transform=transform)
    x, y = f.at(min(a, b)), f.at(max(a, b))
    slack = 1e-9 * low * ratio + 1e-12
    assert low - slack <= x <= y + slack <= low * ratio + 2 * slack


@SETTINGS
@given(st.lists(st.text(min_size=1), min_size=1, max_size=7, unique=True), st.integers(1, 200))
def test_categories_share_the_range_evenly(values, per):
    f = Factor(path="x", values=tuple(values))
    u = (np.arange(per * len(values)) + 0.5) / (per * len(values))
    found = [p["x"] for p in mapped([f], u[:, None])]
    assert all(found.count(v) == per for v in values)


@SETTINGS
@given(st.dictionaries(st.text(), PLAIN, max_size=6), st.randoms())
def test_a_digest_is_of_the_content_and_not_of_its_order(payload, random):
    items = list(payload.items())
    random.shuffle(items)
    job = Job("spectrum", payload)
    assert job.digest == Job("spectrum", dict(items)).digest
    assert job.digest == Job("spectrum", json.loads(json.dumps(payload))).digest
    assert job.digest != Job("ledger", payload).digest
    assert job.digest != Job("spectrum", {**payload, "\x00one more": 1}).digest


@SETTINGS
@given(st.lists(st.integers(0, 9), max_size=30), st.sets(st.integers(0, 9)))
def test_jobs_are_answered_in_order_each_content_once(numbers, kept):
    class Backwards:
        ran: list

        def run(self, jobs):
            self.ran = [j.payload["n"] for j in jobs]
            for k in reversed(range(len(jobs))):
                yield k, {"square": jobs[k].payload["n"] ** 2}

    jobs = [Job("spectrum", {"n": n}) for n in numbers]
    store = MemoryStore()
    for n in kept:
        store.save(Job("spectrum", {"n": n}).digest, {"square": n**2})
    scheduler = Backwards()
    assert run_jobs(jobs, scheduler, store) == [{"square": n**2} for n in numbers]
    assert len(scheduler.ran) == len(set(scheduler.ran))
    assert set(scheduler.ran) == set(numbers) - kept
