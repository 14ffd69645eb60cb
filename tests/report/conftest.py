"""A run folder made of plainly artificial numbers, in the form that `livlab run` writes."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

Writer = Callable[..., Path]


@pytest.fixture
def write_run(tmp_path: Path) -> Writer:
    return partial(written, tmp_path)


@pytest.fixture(scope="session")
def plain_report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of the plain run, for those who only read it."""
    from livlab.kinds.report import build_report

    return build_report(written(tmp_path_factory.mktemp("plain")))


def written(
    place: Path,
    *,
    readings: tuple[str, ...] = ("thesis", "consistent", "measured"),
    wavelengths: int = 12,
    reference: str | None = "human liver",
    claims: bool = True,
    status: str = "complete",
    title: str = "Spectral validation",
    result: bool = True,
    notes: tuple[str, ...] = ("elastin: Q = 70 is above its bound",),
) -> Path:
    folder = place / "spectral-0123456789ab"
    folder.mkdir()
    rng = np.random.default_rng(5)
    x = np.linspace(500, 720, wavelengths)
    fine = np.linspace(500, 720, 221)
    base = 0.05 + 0.2 / (1 + np.exp(-(x - 610) / 15))
    base_fine = 0.05 + 0.2 / (1 + np.exp(-(fine - 610) / 15))
    n = len(readings)
    r = np.array([base * (0.6 + 0.4 * k / max(n - 1, 1)) for k in range(n)])
    curve = np.array([(base_fine / base_fine.max()) ** (1 + 0.2 * k) for k in range(n)])
    dims = ("reading", "wavelength")
    if result:
        data: dict[str, Any] = {
            "reflectance": (dims, r),
            "reflectance_se": (dims, 0.01 * r),
            "diffuse_reflectance": (dims, r),
            "specular": (dims, np.full_like(r, 0.02)),
            "transmittance": (dims, 0 * r),
            "lost": (dims, np.full_like(r, 0.01)),
            "residual": (dims, rng.normal(0, 1e-7, r.shape)),
            "redirect_loss": (dims, r * np.array([1.0] + [0.0] * (n - 1))[:, None]),
            "curve": (("reading", "wavelength_curve"), curve),
            "curve_se": (("reading", "wavelength_curve"), 0.01 * curve),
        }
        absorbed = 1 - sum(np.asarray(data[k][1]) for k in ("reflectance", "specular", "lost", "redirect_loss"))
        data["absorbed"] = (("reading", "layer", "wavelength"), absorbed[:, None, :])
        coords: dict[str, Any] = {
            "reading": list(readings),
            "wavelength": x,
            "wavelength_curve": fine,
            "layer": ["parenchyma"],
        }
        if reference:
            data["reference"] = (("reference_name", "wavelength_curve"), (base_fine / base_fine.max())[None])
            data["reference_sd"] = (("reference_name", "wavelength_curve"), 0.1 * base_fine[None])
            coords["reference_name"] = [reference]
        root = xr.Dataset(data, coords, attrs={"normalisation": "max", "instrument": json.dumps({"kind": "collinear"})})
        root.to_netcdf(folder / "result.nc", engine="h5netcdf")
        absorption = np.abs(np.sin(x / 40)) * np.ones((n, 1, 2, 1))
        absorption[:, :, 1] = 0
        xr.Dataset(
            {
                "absorption": (("reading", "layer", "element", "wavelength"), absorption),
                "scattering": (("reading", "layer", "element", "wavelength"), absorption[:, :, ::-1]),
            },
            {
                "reading": list(readings),
                "layer": ["parenchyma"],
                "element": ["blood", "hepatocyte"],
                "wavelength": x,
            },
        ).to_netcdf(folder / "result.nc", engine="h5netcdf", group="coefficients", mode="a")
    rows: list[tuple[Any, ...]] = []
    if claims:
        rows = [
            ("pearson measured vs human liver 500-720", 0.99345, 0.00042, 1.0, 0.01, "PASS", 12.5),
            ("rmse thesis vs human liver 500-720", 0.31, 0.001, 0.19, 0.04, "FAIL", 3.25),
            ("pearson thesis vs Nachabe 2011 500-720", np.nan, np.nan, 0.97, 0.02, "MISSING", np.nan),
        ]
    columns = ["criterion", "value", "standard_error", "reference", "tolerance", "verdict", "seconds"]
    pd.DataFrame(rows, columns=columns).to_csv(folder / "claims.csv", index=False)
    pd.DataFrame({"layer": ["parenchyma"], "element": ["blood"], "value": [0.084]}).to_csv(
        folder / "tissue.csv", index=False
    )
    pd.DataFrame({"row": [1], "option": ["fibre_density"], "thesis": ["areal"], "differs": [True]}).to_csv(
        folder / "readings.csv", index=False
    )
    pd.DataFrame({"name": ["haemoglobin_prahl"], "doi": [""], "sha256": ["a" * 64]}).to_csv(
        folder / "provenance.csv", index=False
    )
    pd.DataFrame({"stage": ["measure"], "seconds": [12.5], "samples": [1_000_000]}).to_csv(
        folder / "costs.csv", index=False
    )
    (folder / "config.toml").write_text(
        f"schema = 1\nname = 'spectral'\ntitle = {json.dumps(title)}\n", encoding="utf-8"
    )
    manifest = {
        "name": "spectral",
        "digest": "0123456789ab",
        "livlab": "0.1.0",
        "status": status,
        "seconds": 15.0,
        "finished": "2026-01-01T00:00:00Z",
        "command": "livlab run experiments/spectral.toml",
        "notes": list(notes),
        "claim_notes": {"pearson thesis vs Nachabe 2011 500-720": "reference not available"},
        "packages": {"numpy": "2"},
    }
    (folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    return folder
