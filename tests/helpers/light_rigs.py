"""Rigs of a synthetic ball, honest ones and ones that lie about their lights, as photographs without files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation
from synthetic_camera import blinn_phong, camera, lambert, render, ring, sphere_for

from livlab.acquire.photographs.merge import Merged
from livlab.acquire.photographs.rig import DevelopedFrames, PhotographedRig
from livlab.brdf.geometry import Camera, Light, Sphere

CAMERA = camera(110, 100, focal_px=400.0)
SPHERE = sphere_for(CAMERA, 40.0, (-4.0, 5.0))


def oren_nayar(albedo=0.5, sigma=0.6):
    """Oren & Nayar 1994, the qualitative model, literally."""
    a, b = 1 - 0.5 * sigma**2 / (sigma**2 + 0.33), 0.45 * sigma**2 / (sigma**2 + 0.09)

    def value(wi, wo, n):
        ci, co = (np.clip(np.sum(n * w, axis=-1), 1e-6, 1) for w in (wi, wo))
        wi_flat, wo_flat = wi - ci[..., None] * n, wo - co[..., None] * n
        size = np.linalg.norm(wi_flat, axis=-1) * np.linalg.norm(wo_flat, axis=-1)
        turn = np.clip(np.sum(wi_flat * wo_flat, axis=-1) / np.maximum(size, 1e-9), 0, 1)
        ti, to = np.arccos(ci), np.arccos(co)
        return albedo / np.pi * (a + b * turn * np.sin(np.maximum(ti, to)) * np.tan(np.minimum(ti, to)))

    return value


MATTE, GLOSSY, ROUGH = lambert(0.5), blinn_phong(0.3, 0.3, 60.0), oren_nayar()
BROAD, METAL = blinn_phong(0.25, 0.4, 12.0), blinn_phong(0.02, 0.8, 40.0)


@dataclass(frozen=True, eq=False)
class Case:
    """Pictures under the true lights, and what is said of them.

    `said` and `sphere` are what the rig declares, `strength` what each light truly is over what is declared.
    """

    true: Sequence[Light]
    said: Sequence[Light]
    materials: tuple[Callable, ...] = (MATTE, GLOSSY)
    sphere: Sphere = SPHERE
    camera: Camera = CAMERA
    strength: dict[int, float] = field(default_factory=dict)
    noise: float = 0.01
    direction_deg: float = 0.0
    strength_sd: float = 0.0
    spots: float = 0.0
    sees: str = ""


@cache
def pictures(case: Case, which: int) -> np.ndarray:
    return render(CAMERA, SPHERE, case.true, case.materials[which], sub=2)


def photographed(case: Case, draw: int) -> PhotographedRig:
    """The rig of one draw of noise, of the lights' own errors, and of spots."""
    rng = np.random.default_rng([7, draw])
    images = pictures(case, draw % len(case.materials)).copy()
    for k in range(len(images)):
        images[k] *= case.strength.get(k, 1.0) * (1 + case.strength_sd * rng.normal())
    if case.spots:
        coarse = rng.normal(size=(CAMERA.height // 6 + 1, CAMERA.width // 6 + 1)) * case.spots
        images *= 1 + np.kron(coarse, np.ones((6, 6)))[: CAMERA.height, : CAMERA.width]
    level = images.max(axis=0)[images.max(axis=0) > 0].mean()
    variance = (case.noise * level) ** 2 * (0.2 + 0.8 * images / level)
    images = images + rng.normal(size=images.shape) * np.sqrt(variance)
    said = [_off(light, np.deg2rad(case.direction_deg), rng) for light in case.said]

    def develop(k: int) -> Merged:
        return Merged(
            images[k][..., None].astype(np.float32), variance[k][..., None].astype(np.float32), 0.0, 0.0, (1.0,)
        )

    return PhotographedRig(
        name="synthetic",
        frames=DevelopedFrames(develop, len(images), (*images.shape[1:], 1)),
        channels=("grey",),
        camera=case.camera,
        lights=tuple(said),
        sphere=case.sphere,
        pose=None,
        sphere_covariance=np.zeros((4, 4)),
        light_covariances=(np.zeros((3, 3)),) * len(said),
        white=np.ones(1),
        noise_known="declared",
    )


def _off(light: Light, sd: float, rng: np.random.Generator) -> Light:
    if not sd or light.direction is None:
        return light
    turned = light.direction + sd * rng.normal(size=3)
    return replace(light, direction=turned / np.linalg.norm(turned))


def placed_by(lights: Sequence[Light], matrix) -> list[Light]:
    """Lights whose directions, in the frame x right, y up, z to the camera, went through a matrix."""
    turn = np.diag([1.0, -1.0, -1.0])
    whole = turn @ np.asarray(matrix, dtype=float) @ turn
    return [replace(light, direction=whole @ light.direction) for light in lights]


def turned_by(lights: Sequence[Light], degrees) -> list[Light]:
    matrix = Rotation.from_rotvec(np.deg2rad(degrees)).as_matrix()
    return [replace(light, direction=matrix @ light.direction) for light in lights]


def near(lights: Sequence[Light], distance_mm: float, sphere: Sphere = SPHERE) -> list[Light]:
    return [
        Light(light.intensity * distance_mm**2, None, sphere.centre_mm + distance_mm * light.direction)
        for light in lights
    ]


def swapped(lights: Sequence[Light], *pairs: tuple[int, int]) -> list[Light]:
    out = list(lights)
    for a, b in pairs:
        out[a], out[b] = out[b], out[a]
    return out


TWO = ring(6, 35) + ring(6, 70)
ODD = [ring(12, angle)[k] for angle, k in ((35, 0), (60, 1), (25, 3), (45, 4), (70, 6), (30, 8), (50, 10))]
AXIS = (0.0, 0.0, -1.0)
LARGER = Sphere(SPHERE.centre_mm * 1.1, SPHERE.radius_mm * 1.1)
NEAR = near(TWO, 120.0)
ONE_WRONG = [*TWO[:5], replace(TWO[5], direction=np.array([0.48, -0.36, -0.8])), *TWO[6:]]

LIARS = {
    "two of twelve exchanged, ring at 20°": Case(ring(12, 20), swapped(ring(12, 20), (2, 3)), sees="exchanged"),
    "two exchanged, rings at 35° and 70°": Case(TWO, swapped(TWO, (0, 7)), sees="exchanged"),
    "shifted by one, ring at 20°": Case(ring(12, 20), [*ring(12, 20)[1:], ring(12, 20)[0]], sees="shifted by 1"),
    "reversed, ring at 25°": Case(ring(9, 25), ring(9, 25)[::-1], sees="up and down|reversed|another order"),
    "left and right, ring at 30°": Case(
        ring(7, 30), placed_by(ring(7, 30), np.diag([-1, 1, 1])), sees="left and right"
    ),
    "up and down, seven lights": Case(ODD, placed_by(ODD, np.diag([1, -1, 1])), sees="up and down"),
    "the other frame": Case(TWO, placed_by(TWO, np.diag([1, -1, -1])), sees="other frame"),
    "x and y exchanged": Case(ODD, placed_by(ODD, [[0, 1, 0], [1, 0, 0], [0, 0, 1]]), sees="x and y exchanged"),
    "y and z exchanged": Case(ODD, placed_by(ODD, [[1, 0, 0], [0, 0, 1], [0, 1, 0]]), sees="y and z exchanged"),
    "one strength + 20 %": Case(TWO, TWO, strength={4: 1.2}, sees="Light 4 is 1.[12]"),
    "one strength − 20 %, ring at 20°": Case(ring(12, 20), ring(12, 20), strength={7: 0.8}, sees="Light 7 is 0.[78]"),
    "radius 22 for 20 mm, near lights": Case(NEAR, NEAR, sphere=LARGER, sees="radius_mm = (19|20)"),
    "camera rolled by 6°": Case(TWO, turned_by(TWO, [0, 0, 6]), sees="turned by [567]"),
    "camera tilted by 5°": Case(ring(12, 25), turned_by(ring(12, 25), [5, 0, 0]), sees="turned by [456]"),
    "near lights taken as distant": Case(near(TWO, 200.0), TWO, sees="near lights"),
    "one light wrong": Case(TWO, ONE_WRONG, sees="entries of light 5"),
}

HONEST = {
    "matte": Case(TWO, TWO),
    "glossy": Case(TWO, TWO, (GLOSSY, BROAD)),
    "rough": Case(ODD, ODD, (ROUGH,)),
    "metal": Case(TWO, TWO, (METAL,)),
    "three lights": Case(ring(3, 40), ring(3, 40)),
    "one light": Case(ring(1, 40), ring(1, 40)),
    "near lights": Case(NEAR, NEAR),
    "ring at 20°": Case(ring(12, 20), ring(12, 20)),
    "ring at 12°": Case(ring(8, 12), ring(8, 12)),
    "noisy, 8 %": Case(TWO, TWO, noise=0.08),
    "directions ± 1°": Case(TWO, TWO, direction_deg=1.0),
    "strengths ± 2 %": Case(ODD, ODD, strength_sd=0.02),
    "spots of 5 %": Case(TWO, TWO, spots=0.05),
    "lights from behind": Case(ring(5, 40) + ring(4, 110), ring(5, 40) + ring(4, 110)),
}
