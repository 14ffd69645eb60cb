"""Sessions of the tutorial's glossy ball: how far fits move from one to the next, and what sd and intervals say.

Twelve photographs of a painted ball and of a steel ball by Mitsuba, photon and read noise, the lamps at other places in
each session, their directions found from the steel ball; extracted and fitted like anyone's. Run with
`python -m benchmarks.bench_brdf_intervals [SESSIONS]`; five seconds of a processor each.
"""

from __future__ import annotations

import math
import re
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import tifffile
from scipy.spatial.transform import Rotation

from livlab.acquire.instruments.sphere_rig import SphereRig, photograph, ring
from livlab.acquire.photographs.extract import extract_samples
from livlab.acquire.photographs.open import open_rig
from livlab.brdf.fit.fit import fit, pack
from livlab.brdf.fit.problem import BrdfProblem
from livlab.brdf.fit.spread import spread
from livlab.brdf.geometry import Light

PAINT = {"type": "roughplastic", "distribution": "ggx", "alpha": 0.15, "int_ior": 1.5}
ALBEDO = [0.45, 0.2, 0.15]
STEEL = {"type": "roughconductor", "alpha": 0.01, "eta": [2.9, 2.9, 2.6], "k": [3.1, 2.9, 2.8]}
NAMES = ["kd[R]", "kd[G]", "kd[B]", "alpha", "ks[R]", "ks[G]", "ks[B]"]
TRUTH = np.array([*ALBEDO, 0.15, 1.0, 1.0, 1.0])
TUTORIAL = Path(__file__).parents[1] / "docs" / "tutorials" / "ball.md"


def lamps(rng: np.random.Generator) -> list[Light]:
    """The tutorial's two rings, each turned as a whole, each lamp moved by 2 degrees."""
    found = []
    for angle in (35, 70):
        own = ring(6, angle_deg=angle, distance_radii=math.inf)
        axis = np.mean([lamp.direction for lamp in own], axis=0)
        turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * rng.uniform(0, 2 * np.pi))
        for lamp in own:
            nudge = Rotation.from_rotvec(np.deg2rad(2) * rng.standard_normal(3))
            found.append(replace(lamp, direction=nudge.apply(turn.apply(lamp.direction))))
    return found


def session(folder: Path, rng: np.random.Generator) -> list[np.ndarray]:
    """One session: value, sd, lower, upper, and the sd that patches of pictures give, by parameter."""
    rig = SphereRig.make(lamps(rng), radius_px=32, radius_mm=20)

    def shoot(radiance: np.ndarray, name: str) -> None:
        electrons = rng.poisson(np.clip(radiance, 0, None) / 0.4 * 30_000)
        stored = 800 + electrons / 30_000 * 64_000 + rng.normal(0, 20, radiance.shape)
        tifffile.imwrite(folder / name, np.clip(stored, 0, 65_535).astype(np.uint16), photometric="rgb")

    painted = photograph(rig, PAINT | {"diffuse_reflectance": ALBEDO})
    steel = photograph(rig, STEEL)
    for k in range(12):
        shoot(painted.images.values[k], f"ball{k:02d}.tif")
        shoot(steel.images.values[k], f"steel{k:02d}.tif")
    outline = np.repeat(painted.outline.values[..., None], 3, axis=2)
    shoot(0.3 * outline, "silhouette.tif")
    shoot(np.zeros_like(outline), "dark.tif")
    shoot(np.full_like(outline, 0.99 / math.pi), "white.tif")
    data = pack(extract_samples(open_rig(folder)).samples)
    found = fit(data, "plastic", starts=1, widening=False, warn=False)
    table = found.table.loc[NAMES]
    problem = BrdfProblem(found.layout, data, "cosine-weighted-l2")
    other = spread(problem, found.values, resampling="tiles", replicates=0, level=found.level, seed=0).robust.sd
    return [*(table[c].to_numpy() for c in ("value", "sd", "lower", "upper")), np.array([other[n] for n in NAMES])]


def main(sessions: int) -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory() as where:
        folder = Path(where)
        text = re.search(r"<!-- file ball/rig.toml -->\n```toml\n(.*?)```", TUTORIAL.read_text(), re.DOTALL)
        assert text is not None
        (folder / "rig.toml").write_text(text[1])
        drawn = [session(folder, np.random.default_rng(100 + k)) for k in range(sessions)]
    value, sd, lower, upper, patches = np.array(drawn).transpose(1, 0, 2)
    middle, scatter = value.mean(axis=0), value.std(axis=0, ddof=1)
    print(f"{sessions} sessions; ratios of sds are good to {1 / math.sqrt(2 * (sessions - 1)):.2f}")
    print("| parameter | scatter | sd / scatter | from patches | intervals hold the mean | mean off by |")
    print("|---|---|---|---|---|---|")
    held = ((lower <= middle) & (middle <= upper)).mean(axis=0)
    for k, name in enumerate(NAMES):
        ratios = [math.sqrt(np.mean(s[:, k] ** 2)) / scatter[k] for s in (sd, patches)]
        off = f"{100 * (middle[k] / TRUTH[k] - 1):+.2f} %"
        print(f"| `{name}` | {scatter[k]:.2g} | {ratios[0]:.2f} | {ratios[1]:.2f} | {100 * held[k]:.0f} % | {off} |")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 60)
