"""Samples of a sphere under lights, of materials and rigs that a fitted model does not know; no pixels."""

from typing import NamedTuple

import numpy as np

from livlab.brdf.angles import local_frames
from livlab.brdf.models.model import model
from livlab.brdf.samples import sample_dataset


class Seen(NamedTuple):
    """True directions and told ones to the light, to the eye, light's number, normals in the world."""

    wi: np.ndarray
    told: np.ndarray
    wo: np.ndarray
    light: np.ndarray
    normal: np.ndarray


def sphere(lights, each, rng, first=15.0, last=110.0, off_rad=0.0):
    """Random visible points of a sphere under distant lights; `off_rad` turns the third light by so much when told."""
    parts = []
    for k, angle in enumerate(np.deg2rad(np.linspace(first, last, lights))):
        turn = 2.4 * k
        to_light = np.array([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])
        xy = rng.uniform(-1, 1, (60 * each, 2))
        xy = xy[np.sum(xy**2, 1) < 0.97]
        normal = np.column_stack([xy, np.sqrt(1 - np.sum(xy**2, 1))])
        middle = to_light + np.array([0, 0, 1.0])
        middle = middle / np.linalg.norm(middle)
        # A third of the points about the highlight, as a camera's pixels are where a lobe is wide.
        close = middle + 0.35 * rng.standard_normal((20 * each, 3))
        close = close / np.linalg.norm(close, axis=1, keepdims=True)
        normal = np.concatenate([close[: each // 3], normal])
        good = (normal @ to_light > 0.18) & (normal[:, 2] > 0.18)
        normal = normal[good][:each]
        told = to_light
        if off_rad and k == 2:
            aside = np.cross(to_light, [0.0, 1.0, 0.0])
            told = np.cos(off_rad) * to_light + np.sin(off_rad) * aside / np.linalg.norm(aside)
        frames = local_frames(normal)
        wo = frames @ np.array([0, 0, 1.0])
        parts.append((frames @ to_light, frames @ told, wo, np.full(len(normal), k), normal))
    return Seen(*(np.concatenate(p) for p in zip(*parts, strict=True)))


def anisotropic(wi, wo, ks, ax, ay):
    """GGX with two roughnesses, no Fresnel term, separable Smith shadowing (Heitz 2014, eq. 85, 86), literally."""
    h = wi + wo
    h = h / np.linalg.norm(h, axis=1, keepdims=True)
    d = 1 / (np.pi * ax * ay * ((h[:, 0] / ax) ** 2 + (h[:, 1] / ay) ** 2 + h[:, 2] ** 2) ** 2)

    def g(w):
        a2 = ((w[:, 0] * ax) ** 2 + (w[:, 1] * ay) ** 2) / w[:, 2] ** 2
        return 2 / (1 + np.sqrt(1 + a2))

    return ks * d * g(wi) * g(wo) / (4 * wi[:, 2] * wo[:, 2])


def of(name, **values):
    """A model of livlab as the truth."""
    return lambda s: model(name).evaluate(s.wi, s.wo, values).reshape(-1)


def clean(s, value):
    """Samples without noise: values at the true directions, with the directions that were told."""
    data = sample_dataset(s.told, s.wo, value, standard_error=np.full(len(value), np.nan))
    return data.assign_coords(light=("sample", s.light))


def noisy(s, value, sd, rng, stated=1.0):
    """With noise `sd`, a number or one a sample, in f cos θ_i; `stated` times it is what the samples say."""
    error = sd / s.told[:, 2]
    data = clean(s, value + error * rng.standard_normal(len(value)))
    return data.assign(standard_error=(("sample", "channel"), stated * error[:, None]))
