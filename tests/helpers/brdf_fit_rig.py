"""Pictures of a sphere made by summing a model over many points in each pixel: no renderer, no code of the fit."""

import numpy as np
import xarray as xr

from livlab.brdf.angles import local_frames
from livlab.brdf.geometry import Camera, Light, Sphere
from livlab.brdf.models.model import model

RADIUS_MM = 25.0


def lights(count, channels=1, distance=250.0, first=10.0, last=120.0, near=True):
    found = []
    for k, angle in enumerate(np.deg2rad(np.linspace(first, last, count))):
        turn = 0.4 * k
        towards = np.array([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])
        if near:
            found.append(Light(np.full(channels, distance**2), position_mm=distance * towards))
        else:
            found.append(Light(np.ones(channels), direction=towards))
    return found


def camera(radius_px):
    size = 2 * int(np.ceil(radius_px + 6)) + 1
    focal = radius_px * np.sqrt(99.0)
    middle = (size - 1) / 2
    matrix = np.array([[focal, 0, middle], [0, focal, middle], [0, 0, 1]])
    return Camera(size, size, matrix, np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 10 * RADIUS_MM]))


def pictures(name, values, lamps, radius_px=40.0, inside=10):
    """Images (light, row, column, channel) with `inside` x `inside` points a pixel, and the rig."""
    eye, sphere = camera(radius_px), Sphere(np.zeros(3), RADIUS_MM)
    channels = lamps[0].intensity.size
    columns, rows = np.meshgrid(np.arange(eye.width), np.arange(eye.height))
    total = np.zeros((len(lamps), eye.height, eye.width, channels))
    steps = (np.arange(inside) + 0.5) / inside - 0.5
    one = model(name)
    for across in steps:
        for down in steps:
            origins, directions = eye.rays(columns + across, rows + down)
            hits = sphere.meet(origins, directions)
            frames = local_frames(hits.normals)
            wo = np.einsum("...ij,...j->...i", frames, -directions)
            for k, lamp in enumerate(lamps):
                towards, scale = lamp.at(hits.points_mm)
                wi = np.einsum("...ij,...j->...i", frames, towards)
                lit = hits.hit & (wi[..., 2] > 0) & (wo[..., 2] > 0)
                f = one.evaluate(wi[lit], wo[lit], values).reshape(-1, channels if np.ndim(values["kd"]) else 1)
                total[k][lit] += f * (scale * wi[..., 2])[lit][:, None] * lamp.intensity
    images = xr.DataArray(total / inside**2, dims=("light", "row", "column", "channel"))
    return images, eye, lamps, sphere
