"""Compression of a ledger: what it keeps, and within what."""

import math

import numpy as np
import pytest
from ledger_tissue import tissue

from livlab.errors import InputError
from livlab.model.transport.ledger.compress import AnchorDomain, compress, widened
from livlab.model.transport.ledger.data import Anchors, Coefficients, Entries, sort_entries
from livlab.model.transport.ledger.evaluate import Rows, select, sums
from livlab.model.transport.ledger.record_ledger import Detector, record
from livlab.model.transport.tally import Tally


@pytest.fixture(scope="module")
def ledger(libllvm):
    return record(tissue(), samples=20_000, seed=3, tally=Tally(theta_edges=(0.0, 0.5, 1.0, math.pi / 2)))


def test_compression_keeps_answers_within_its_tolerance(ledger):
    small = ledger.compressed(1e-4, scattering_spread=0.02)
    assert len(small) < 0.5 * len(ledger)
    assert small.compression.error <= 1e-4
    rng = np.random.default_rng(0)
    served = ledger.served
    for _ in range(5):
        a = served.absorption * (1 + 0.2 * rng.uniform(-1, 1, 2))
        s = served.scattering * (1 + 0.02 * rng.uniform(-1, 1, 2))
        before, after = (x.evaluate(a, s, wavelength_nm=served.wavelength_nm, gradient=True) for x in (ledger, small))
        assert np.abs(after.value - before.value).max() < 2e-4
        assert np.allclose(after.value_se, before.value_se, rtol=0.1)
        for name in ("d_absorption", "d_scattering"):
            off = np.abs(after[name] - before[name]) / before[f"{name}_se"]
            assert float(off.max()) < 0.5
    assert np.allclose(small.spectrum().reflectance_binned, ledger.spectrum().reflectance_binned, atol=2e-4)


def test_a_finer_tolerance_keeps_more_rows(ledger):
    sizes = [len(ledger.compressed(t)) for t in (1e-3, 1e-4, 1e-5)]
    assert sizes[0] < sizes[1] < sizes[2]


def test_a_compressed_ledger_knows_its_bounds(ledger):
    small = ledger.compressed(1e-3)
    served = ledger.served
    assert small.spectrum().valid.all()
    far = served.absorption.max(axis=0) * [1.0, 3.0]
    assert not small.evaluate(far, served.scattering[4], wavelength_nm=600.0).valid.any()
    assert ledger.evaluate(far, served.scattering[4], wavelength_nm=600.0).valid.all()
    small.answer(served, Detector("up", (0.0, 0.5)))
    with pytest.raises(InputError, match="knows only the bins"):
        small.answer(served, Detector("up", (0.0, 0.4)))
    with pytest.raises(InputError, match="compressed already"):
        small.compressed()


def test_compression_of_one_exponent_is_a_histogram():
    """Rows that differ in one feature only, over a wide domain: few rows do."""
    rng = np.random.default_rng(1)
    n = 20_000
    x = rng.exponential(5.0, (n, 1)).astype(np.float32)
    zero = np.zeros(n)
    rows = sort_entries(
        Entries(
            zero.astype(np.uint16),
            zero.astype(np.uint8),
            zero.astype(np.int32),
            x,
            zero.astype(np.float32),
            np.ones(n, np.float32),
            np.ones(n, np.float32),
            np.empty(0, np.float32),
        )
    )
    anchors = Anchors(np.array([500.0]), *(np.ones((1, 1)) for _ in range(4)), np.array([n]))
    theta = -np.linspace(0.0, 2.0, 41)[None, :]
    small = compress(rows, anchors, [AnchorDomain(theta, np.ones(41))], 1e-5)
    assert len(small) < 400
    truth = np.exp(x.astype(float) @ theta).mean(0)
    lots = [Rows(np.pad(r.features, ((0, 0), (0, 3))), r.log_weight, r.concentration) for r in (rows, small)]
    found = [sums(r, theta) for r in lots]
    # The tolerance is met by a prediction; `Ledger.compressed` measures and repeats.
    assert np.abs(found[1].count / n - truth).max() < 2e-5
    assert np.allclose(found[1].square, found[0].square, rtol=0.02)


def test_widened_changes_one_coefficient_at_a_time():
    served = Coefficients.of(tissue())
    found = widened(served, 0.2, 0.05)
    assert len(found) == len(served) * (1 + 2 * 2 * 2)
    changed = np.concatenate([found.absorption, found.scattering], axis=1).reshape(-1, len(served), 4)
    differs = (np.abs(changed / changed[0] - 1.0) > 1e-12).any(1).sum(1)
    assert sorted(differs.tolist()) == [0] + [1] * 8


def test_select_keeps_rows_of_each_walk_apart(ledger):
    rows = select(ledger.entries, len(ledger.anchors), Detector.total(), ledger.tally, False)
    assert sum(len(r.log_weight) for r in rows) == int((ledger.entries.side == 0).sum())
