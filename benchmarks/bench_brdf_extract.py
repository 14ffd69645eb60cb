"""Extraction and merging of BRDF samples: seconds, peak memory, and the errors that resolution makes.

Run by `python -m benchmarks.bench_brdf_extract`. The images are a closed form of a Lambertian sphere under near lights,
16 bit; they are made before the clock starts and count in the memory. Each case runs in a process of its own, so that
its peak is its own.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time

import numpy as np
import xarray as xr
from rich.console import Console
from rich.table import Table

from livlab.brdf.footprint import footprints
from livlab.brdf.geometry import Camera, Light, Sphere
from livlab.brdf.grid import Grid
from livlab.brdf.sphere import by_light, extract
from livlab.brdf.table import merge

CASES = {
    "12 lights, R 115 px, 1 channel": (12, 250, 250, 115.0, 1, "whole"),
    "12 lights, R 115 px, 3 channels": (12, 250, 250, 115.0, 3, "whole"),
    "96 images 612 x 512, R 120 px, 3 channels": (96, 612, 512, 120.0, 3, "whole"),
    "96 images 612 x 512, R 240 px, 3 channels": (96, 612, 512, 240.0, 3, "whole"),
    "96 images 612 x 512, R 240 px, 3 channels, light by light": (96, 612, 512, 240.0, 3, "by light"),
}


def rig(count: int, width: int, height: int, radius_px: float, channels: int) -> tuple[Camera, list[Light], Sphere]:
    focal = radius_px * np.sqrt(99)
    matrix = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    camera = Camera(width, height, matrix, translation=np.array([0, 0, 200.0]))
    turn = np.arange(count) * 2.399963
    lean = np.arccos(1 - 1.2 * (np.arange(count) + 0.5) / count)
    towards = np.stack([np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), -np.cos(lean)], axis=1)
    return camera, [Light(np.full(channels, 4e4), position_mm=200 * d) for d in towards], Sphere(np.zeros(3), 20.0)


def pictures(camera: Camera, lights: list[Light], sphere: Sphere, channels: int) -> xr.DataArray:
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    hits = sphere.meet(*camera.rays(columns, rows))
    out = np.zeros((len(lights), camera.height, camera.width, channels), dtype=np.uint16)
    for frame, light in zip(out, lights, strict=True):
        towards, scale = light.at(hits.points_mm)
        cosine = np.maximum(np.sum(towards * hits.normals, axis=-1), 0) * hits.hit
        frame[:] = np.rint(20000 * scale * 4e4 * cosine)[..., None]
    return xr.DataArray(out, dims=("light", "row", "column", "channel"))


def run(name: str) -> None:
    count, width, height, radius_px, channels, how = CASES[name]
    camera, lights, sphere = rig(count, width, height, radius_px, channels)
    images = pictures(camera, lights, sphere, channels)
    white = 20000 * np.pi / 0.5
    start = time.perf_counter()
    if how == "whole":
        samples = extract(images, camera, lights, sphere, white=white)
        extracted = time.perf_counter() - start
        table = merge(samples, Grid.uniform())
        error = float(np.sqrt(np.mean((samples["value"].values[::7] * np.pi / 0.5 - 1) ** 2)))
    else:
        extracted = float("nan")
        parts = by_light(images, camera, lights, sphere, white=white)
        table = merge(parts, Grid.uniform())
        value = table["value"].values
        error = float(np.sqrt(np.nanmean((value * np.pi / 0.5 - 1) ** 2)))
    seconds = time.perf_counter() - start
    inside = float("nan")
    if count == 12:
        start = time.perf_counter()
        for _ in footprints(samples, 3, rule="gauss"):
            pass
        inside = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"{table.attrs['samples']}\t{extracted:.2f}\t{seconds:.2f}\t{inside:.2f}\t{peak:.0f}"
        f"\t{100 * table.attrs['coverage']:.1f}\t{100 * error:.4f}"
    )


def main() -> None:
    table = Table(title="Lambertian sphere, 16 bit, camera and lights at 10 R")
    for head in ("case", "samples", "extract s", "+ merge s", "footprints 3x3 s", "peak MiB", "cells %", "rms error %"):
        table.add_column(head, justify="left" if head == "case" else "right")
    for name in CASES:
        command = [sys.executable, "-m", "benchmarks.bench_brdf_extract", name]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        table.add_row(name, *done.stdout.strip().split("\t"))
    Console(width=150).print(table)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        run(sys.argv[1])
    else:
        main()
