"""The optics job: efficiencies and phase functions of spheres, or absorption spectra, with their claims and tables."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from livlab import datasets
from livlab.criteria import Claim
from livlab.errors import InputError
from livlab.kinds.optics import tables
from livlab.kinds.optics.claims import absorption_claims, published_claims, scattering_claims
from livlab.kinds.optics.config import Chromophore, OpticsExperiment
from livlab.kinds.shared.tissue_tables import Made
from livlab.model.tissue.chromophores import whole_blood
from livlab.model.tissue.particles.rayleigh import SIZE_LIMIT, rayleigh_efficiency
from livlab.model.tissue.particles.sphere import mie, mie_phase, size_parameter
from livlab.model.tissue.phase.functions import Rayleigh
from livlab.units import FloatArray, per_mm_to_per_cm

if TYPE_CHECKING:
    from livlab.runs.work import Run

ANGLES = 721
SIZES = (0.01, 30.0, 300)
"""First and last size parameter, and number, of the curve that tells where Rayleigh's law holds."""


def prepare(config: OpticsExperiment) -> Callable[[Run], None]:
    """Load what the figures need.

    Parameters
    ----------
    config
        A resolved experiment.

    Returns
    -------
    The job: called with the run, it computes, judges and writes the run's files.

    Raises
    ------
    DatasetError
        A dataset that is missing or was tampered with, or a column it does not have.
    InputError
        A molar extinction without a concentration, or an absorption with one.
    """
    if config.particle:
        return lambda run: _scattering(run, config)
    started = time.perf_counter()
    data = absorption(config.chromophore, config.wavelengths.grid())
    seconds = time.perf_counter() - started
    return lambda run: _absorption(run, config, data, seconds)


def scattering(config: OpticsExperiment) -> xr.Dataset:
    """Efficiencies and phase functions of every particle, by Mie's series and by Rayleigh's law.

    Rayleigh's law is taken with the index relative to the medium, so that both are about the same sphere.

    Returns
    -------
    Dataset. Dims (particle, radius, wavelength): `size_parameter`, `mie`, `rayleigh` (scattering efficiencies),
    `anisotropy`; (particle, radius, theta): `phase_mie`, `phase_rayleigh` in 1/sr at `phase_wavelength_nm`;
    (particle, size): `ratio` of the efficiencies, Rayleigh's over Mie's, against the size parameter.
    """
    grid = config.wavelengths.grid()
    radius = np.array(config.radii_um)
    theta = np.linspace(0.0, np.pi, ANGLES)
    sizes = np.geomspace(*SIZES)
    parts = []
    for p in config.particle:
        m = p.n_particle / p.n_medium
        x = size_parameter(radius[:, None] * 1e-3, grid, p.n_medium)
        found = mie(m, x)
        cosine = np.cos(theta)
        at = size_parameter(radius * 1e-3, config.phase_wavelength_nm, p.n_medium)
        over = ("radius", "wavelength")
        parts.append(
            xr.Dataset(
                {
                    "size_parameter": (over, x),
                    "mie": (over, found.q_sca),
                    "rayleigh": (over, rayleigh_efficiency(m, x)),
                    "anisotropy": (over, found.anisotropy),
                    "phase_mie": (
                        ("radius", "theta"),
                        np.stack([mie_phase(m, float(s)).pdf(cosine) for s in at]),
                    ),
                    "phase_anisotropy": ("radius", mie(m, at).anisotropy),
                    "phase_rayleigh": ("theta", Rayleigh().pdf(cosine)),
                    "ratio": ("size", rayleigh_efficiency(m, sizes) / mie(m, sizes).q_sca),
                }
            )
        )
    names = xr.DataArray([p.label for p in config.particle], dims="particle", name="particle")
    result = xr.concat(parts, dim=names, data_vars="all").assign_coords(
        radius=("radius", radius, {"units": "um"}),
        wavelength=("wavelength", grid, {"units": "nm"}),
        theta=("theta", theta, {"units": "rad"}),
        size=("size", sizes, {"units": "1"}),
    )
    for name in ("mie", "rayleigh", "anisotropy", "ratio", "size_parameter"):
        result[name].attrs["units"] = "1"
    for name in ("phase_mie", "phase_rayleigh"):
        result[name].attrs["units"] = "1/sr"
    return result.assign_attrs(phase_wavelength_nm=config.phase_wavelength_nm, rayleigh_size_limit=SIZE_LIMIT)


def absorption(chromophores: tuple[Chromophore, ...], wavelength_nm: FloatArray) -> xr.Dataset:
    """Absorption coefficient of each chromophore in 1/cm; nan outside its dataset's range.

    Returns
    -------
    Dataset. Dims (chromophore, wavelength): `absorption` in 1/cm.

    Raises
    ------
    DatasetError, InputError
        As `prepare`.
    """
    rows = []
    for c in chromophores:
        data = datasets.load(c.dataset)
        unit = data.unit(c.column)
        low, high = data.range_nm
        inside = (wavelength_nm >= low) & (wavelength_nm <= high)
        row = np.full(len(wavelength_nm), np.nan)
        molar = unit.replace(" ", "") in ("1/(cmM)", "1/(Mcm)")
        if molar != (c.haemoglobin_g_per_l is not None):
            bound = f"{c.column} is in {unit}: " + ("it needs haemoglobin_g_per_l" if molar else "it needs none")
            raise InputError.of(f"chromophore {c.label!r}", c.haemoglobin_g_per_l, bound, "Mend the chromophore.")
        if c.haemoglobin_g_per_l is not None:
            extinction = data.interpolate(c.column, wavelength_nm[inside])
            per_mm = whole_blood(1.0, extinction, np.zeros_like(extinction), c.haemoglobin_g_per_l)
            row[inside] = per_mm_to_per_cm(per_mm)
        else:
            row[inside] = data.interpolate(c.column, wavelength_nm[inside], unit="1/cm")
        rows.append(row)
    return xr.Dataset(
        {"absorption": (("chromophore", "wavelength"), np.array(rows), {"units": "1/cm"})},
        coords={
            "chromophore": [c.label for c in chromophores],
            "wavelength": ("wavelength", wavelength_nm, {"units": "nm"}),
        },
    )


def _scattering(run: Run, config: OpticsExperiment) -> None:
    run.progress.begin(["Mie and Rayleigh"])
    started = time.perf_counter()
    data = scattering(config)
    computed = time.perf_counter()
    claims = [*scattering_claims(data, config), *published_claims(config)]
    judged = time.perf_counter()
    run.progress.advance("Mie and Rayleigh", 1.0)
    made = {
        "efficiencies.csv": tables.efficiencies(data),
        "phase.csv": tables.phase(data),
        "validity.csv": tables.validity(data),
    }
    seconds = {"efficiencies and phase functions": computed - started, "claims": judged - computed}
    _finish(run, config, data, made, claims, seconds)


def _absorption(run: Run, config: OpticsExperiment, data: xr.Dataset, seconds: float) -> None:
    run.progress.begin(["absorption"])
    started = time.perf_counter()
    claims = absorption_claims(data, config)
    judged = time.perf_counter()
    run.progress.advance("absorption", 1.0)
    made = {"absorption.csv": tables.absorption(data), "provenance.csv": tables.provenance(config)}
    _finish(run, config, data, made, claims, {"spectra from datasets": seconds, "claims": judged - started})


def _finish(
    run: Run,
    config: OpticsExperiment,
    data: xr.Dataset,
    made: dict[str, Made],
    claims: list[Claim],
    seconds: dict[str, float],
) -> None:
    run.write_result({"/": data})
    costs = [{"stage": k, "seconds": s} for k, s in seconds.items()]
    sources = {c.name: c.source for c in config.criterion if c.source}
    run.finish(claims, made, (("stage", "seconds"), costs), sources)
