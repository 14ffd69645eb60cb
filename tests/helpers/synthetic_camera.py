"""A numpy camera for tests: a sphere of known reflectance, then the faults of a real camera one by one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from livlab.brdf.geometry import Camera, Light, Sphere


def camera(width=180, height=160, focal_px=500.0, distortion=(), **more) -> Camera:
    matrix = np.array([[focal_px, 0, (width - 1) / 2 + 3.0], [0, focal_px, (height - 1) / 2 - 2.0], [0, 0, 1.0]])
    return Camera(width, height, matrix, distortion=np.array(distortion, dtype=float), **more)


def sphere_for(cam: Camera, radius_px: float, offset_px=(0.0, 0.0), radius_mm=20.0) -> Sphere:
    """A sphere that a camera at the origin sees about radius_px wide at an offset from the principal point."""
    depth = cam.matrix[0, 0] * radius_mm / radius_px
    at = np.array([offset_px[0] * depth / cam.matrix[0, 0], offset_px[1] * depth / cam.matrix[1, 1], depth])
    return Sphere(cam.rotation.T @ (at - cam.translation), radius_mm)


def lambert(albedo=0.5):
    return lambda wi, wo, n: np.full(wi.shape[:-1], albedo / np.pi)


def blinn_phong(kd=0.3, ks=0.4, exponent=40.0):
    def value(wi, wo, n):
        h = wi + wo
        h = h / np.linalg.norm(h, axis=-1, keepdims=True)
        lobe = (exponent + 2) / (2 * np.pi) * np.clip(np.sum(n * h, axis=-1), 0, 1) ** exponent
        return kd / np.pi + ks * lobe

    return value


def view_rays(cam: Camera, uv: np.ndarray) -> np.ndarray:
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    lens = cam.distortion if cam.distortion.size else None
    xy = cv2.undistortPoints(uv.reshape(-1, 1, 2), cam.matrix, lens, criteria=stop).reshape(-1, 2)
    d = np.column_stack([xy, np.ones(len(xy))])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return (d @ cam.rotation).reshape(*uv.shape[:-1], 3)


def render(
    cam: Camera, sphere: Sphere, lights: Sequence[Light], brdf: Callable, *, sub=4, background=0.0
) -> np.ndarray:
    """Linear radiance (light, row, column), box-filtered over sub x sub rays a pixel."""
    eye = -cam.rotation.T @ cam.translation
    total = np.zeros((len(lights), cam.height, cam.width))
    rows, columns = np.mgrid[0 : cam.height, 0 : cam.width].astype(float)
    for i in range(sub):
        for j in range(sub):
            uv = np.stack([columns + (i + 0.5) / sub - 0.5, rows + (j + 0.5) / sub - 0.5], axis=-1)
            d = view_rays(cam, uv)
            b = d @ (sphere.centre_mm - eye)
            gap = b**2 - np.sum((sphere.centre_mm - eye) ** 2) + sphere.radius_mm**2
            hit = gap > 0
            x = eye + (b - np.sqrt(np.where(hit, gap, 0)))[..., None] * d
            n = (x - sphere.centre_mm) / sphere.radius_mm
            for k, light in enumerate(lights):
                if light.direction is not None:
                    wi = np.broadcast_to(light.direction, x.shape)
                    e = float(light.intensity[0])
                else:
                    to = light.position_mm - x
                    far = np.linalg.norm(to, axis=-1, keepdims=True)
                    wi, e = to / far, float(light.intensity[0]) / far[..., 0] ** 2
                cosine = np.clip(np.sum(wi * n, axis=-1), 0, None)
                total[k] += np.where(hit, brdf(wi, -d, n) * e * cosine, background)
    return total / sub**2


def ring(count: int, angle_deg: float, about=(0.0, 0.0, -1.0), intensity=1.0) -> list[Light]:
    """Distant lights on a cone about the direction towards the camera (world -z for a camera at the origin)."""
    z = np.asarray(about) / np.linalg.norm(about)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    a = np.deg2rad(angle_deg)
    phi = 2 * np.pi * np.arange(count) / count
    made = [np.cos(a) * z + np.sin(a) * (np.cos(p) * x + np.sin(p) * y) for p in phi]
    return [Light(intensity=np.array([intensity]), direction=d) for d in made]


@dataclass
class Faults:
    """What a real camera does to linear radiance, in its order."""

    exposure: float = 1.0
    vignetting: float = 0.0
    stray: float = 0.0
    dark: float = 0.0
    gain: float = 0.0
    read: float = 0.0
    clip: bool = True
    gamma: float = 1.0
    bits: int = 0
    seed: int = 0
    shape: Callable | None = field(default=None)

    def flat(self, height: int, width: int) -> np.ndarray:
        v, u = np.mgrid[0:height, 0:width]
        r2 = ((u - (width - 1) / 2) ** 2 + (v - (height - 1) / 2) ** 2) / ((width / 2) ** 2 + (height / 2) ** 2)
        return 1 - self.vignetting * r2

    def __call__(self, radiance: np.ndarray, salt: int = 0) -> np.ndarray:
        signal = np.asarray(radiance, dtype=float) * self.exposure
        signal = signal + self.stray * signal.max()
        signal = signal * self.flat(*signal.shape[:2]) + self.dark
        if self.gain or self.read:
            rng = np.random.default_rng([self.seed, salt])
            spread = np.sqrt(self.gain * np.clip(signal, 0, None) + self.read**2)
            signal = signal + rng.normal(size=signal.shape) * spread
        if self.clip:
            signal = np.clip(signal, 0, 1)
        signal = np.sign(signal) * np.abs(signal) ** (1 / self.gamma)
        if self.shape is not None:
            signal = self.shape(signal)
        if self.bits:
            full = 2**self.bits - 1
            signal = np.round(np.clip(signal, 0, 1) * full).astype(np.uint8 if self.bits <= 8 else np.uint16)
        return signal
