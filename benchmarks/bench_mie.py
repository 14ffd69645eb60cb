"""Seconds per 1000 wavelengths of Lorenz–Mie at x about 1, 100 and 10⁴, beside miepython without compilation.

Both run in this one process, alternately, best of three; run by hand:

    python benchmarks/bench_mie.py
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from miepython import mie_nojit

from livlab.model.tissue.particles.cylinder import cylinder_mean
from livlab.model.tissue.particles.sphere import mie, mie_phase

INDEX = 1.5 / 1.35


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def peer(sizes: np.ndarray) -> list[float]:
    return [mie_nojit._single_sphere_py(complex(INDEX), float(x), 0, True)[1] for x in sizes]


def main() -> None:
    mie(INDEX, [0.01, 1.0, 1e4])
    cylinder_mean(INDEX, 1.0)
    print(f"{'x':>8} {'livlab':>12} {'miepython':>12} {'ratio':>8} {'largest difference':>20}")
    for x, ours_count, peer_count in ((1.0, 1000, 1000), (100.0, 1000, 200), (1e4, 50, 3)):
        ours_x = x * np.linspace(1.0, 1.1, ours_count)
        peer_x = ours_x[:: max(1, ours_count // peer_count)][:peer_count]
        own, other = [], []
        for _ in range(3):
            own.append(seconds(lambda s=ours_x: mie(INDEX, s)) * 1000.0 / ours_x.size)
            other.append(seconds(lambda s=peer_x: peer(s)) * 1000.0 / peer_x.size)
        off = np.abs(np.array(peer(peer_x)) / mie(INDEX, peer_x).q_sca - 1.0).max()
        print(f"{x:8g} {min(own):12.4g} {min(other):12.4g} {min(other) / min(own):8.1f} {off:20.1e}")

    sizes = np.linspace(20.0, 60.0, 50)
    best = min(seconds(lambda: cylinder_mean(INDEX, sizes)) for _ in range(3))
    print(f"cylinder_mean, 50 sizes from 20 to 60: {best:.3f} s")
    for x in (29.0, 30.0, 1000.0):  # the first compiles
        print(f"mie_phase at x = {x:g}: {seconds(lambda size=x: mie_phase(INDEX, size)):.4f} s")


if __name__ == "__main__":
    main()
