"""Runners for sums over very many photons, without walking them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from livlab.stress.measured import Measured, runner, values


@runner
def lane_sums(contributions: list[float], photons: int) -> dict[str, Measured]:
    """Registers filled with one contribution over and over, blocks of them added on the host.

    `mean`: of so many photons; `error`: their standard error, which for equal contributions is 0 but for the
    rounding of the squares; `float32`: what a single-precision sum alone makes of the mean, for the table.
    """
    from livlab.model.transport.device import device
    from livlab.model.transport.tally import LANE_PHOTONS, SampleMoments
    from livlab.model.transport.walk.observers import Register

    d, lanes = device("llvm"), 1 << 14
    blocks = math.ceil(photons / (lanes * LANE_PHOTONS))
    means, errors = [], []
    for x in contributions:
        value = d.dr.opaque(d.Float, x)

        def body(k: Any, *sums: Any, value: Any = value) -> Any:
            return (k + 1, *Register.add(d, sums, d.Bool(True), value))

        state = (d.dr.zeros(d.UInt32, lanes), *Register.start(d, lanes))
        _, *sums = d.dr.while_loop(state, lambda k, *_: k < LANE_PHOTONS, body)
        block = Register.moments(tuple(sums), 1, lanes * LANE_PHOTONS)
        total: SampleMoments = block
        for _ in range(blocks - 1):
            total = total + block
        means.append(float(total.mean[0]) / float(np.float32(x)))
        errors.append(float(total.standard_error[0]) / abs(x))
    return values(mean=means, error=errors, photons=float(total.n))


@runner
def mixed_sums(photons: int, seed: int) -> dict[str, Measured]:
    """A register's sum of contributions from 1e-12 to 1, in random order and of both signs, against an exact sum."""
    from livlab.model.transport.device import device
    from livlab.model.transport.tally import LANE_PHOTONS
    from livlab.model.transport.walk.observers import Register

    d = device("llvm")
    lanes = photons // LANE_PHOTONS
    rng = np.random.default_rng(seed)
    x = (10.0 ** rng.uniform(-12, 0, (LANE_PHOTONS, lanes)) * rng.choice([-1, 1, 1], (LANE_PHOTONS, lanes))).astype(
        np.float32
    )
    table = d.Float(x.ravel())

    def body(k: Any, *sums: Any) -> Any:
        value = d.dr.gather(d.Float, table, k * lanes + d.dr.arange(d.UInt32, lanes))
        return (k + 1, *Register.add(d, sums, d.Bool(True), value))

    state = (d.dr.zeros(d.UInt32, lanes), *Register.start(d, lanes))
    _, *sums = d.dr.while_loop(state, lambda k, *_: k < LANE_PHOTONS, body)
    found = Register.moments(tuple(sums), 1, x.size)
    exact, squares = math.fsum(map(float, x.ravel())), math.fsum(float(v) ** 2 for v in x.ravel())
    return values(sum=float(found.total[0]) / exact, squares=float(found.squares[0]) / squares)


@runner
def host_sums(photons: float, parts: int) -> dict[str, Measured]:
    """SampleMoments of so many photons in unlike parts: the mean and the error of a coin, p = 0.3."""
    from livlab.model.transport.tally import SampleMoments

    rng = np.random.default_rng(5)
    cuts = rng.dirichlet(np.ones(parts)) * photons
    total: SampleMoments | None = None
    for n in np.maximum(np.rint(cuts), 1).astype(np.int64):
        hits = np.array([round(0.3 * int(n))], dtype=np.float64)
        part = SampleMoments(int(n), hits, hits)
        total = part if total is None else total + part
    assert total is not None
    error = math.sqrt(0.3 * 0.7 / total.n)
    return values(mean=total.mean, error=float(total.standard_error[0]) / error)
