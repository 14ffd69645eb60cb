"""What each instrument asks of the light that leaves a stack, and how it makes one number of it."""

from __future__ import annotations

import math

import numpy as np

from livlab.acquire.instruments.models import Collinear, FibreProbe, HyperspectralCamera, Instrument, IntegratingSphere
from livlab.model.transport.geometry import Readout
from livlab.model.transport.source import Source
from livlab.model.transport.tally import Tally
from livlab.units import FloatArray

__all__ = ["PROBE_BINS", "Readout", "probe_weights", "readout"]

PROBE_BINS = 48


def readout(instrument: Instrument, n_above: FloatArray) -> Readout:
    """The instrument over a stack whose medium above has the indices `n_above` (one a wavelength)."""
    if isinstance(instrument, Collinear):
        half = None if instrument.sample_side_mm == "infinite" else instrument.sample_side_mm / 2
        face = half or 0.0 if instrument.beam == "face" else 0.0
        return _cone(
            Source.collimated(square_half_width_mm=face),
            instrument.acceptance_deg,
            half,
            specular=instrument.specular == "included",
        )
    if isinstance(instrument, HyperspectralCamera):
        # Even light on an endless surface, seen at one place: by reciprocity a pencil, seen everywhere.
        source = Source.collimated(math.radians(instrument.illumination_deg))
        return _cone(source, instrument.acceptance_deg, None, specular=instrument.polarisation == "none")
    if isinstance(instrument, IntegratingSphere):
        return _sphere(instrument)
    return _probe(instrument, n_above)


def _cone(source: Source, acceptance_deg: float, half_width_mm: float | None, *, specular: bool) -> Readout:
    """Radiance factor: π L / E = flux within the cone over sin²α (a Lambertian sends that share there)."""
    acceptance = math.radians(acceptance_deg)
    weight = 1.0 / math.sin(acceptance) ** 2
    whole = acceptance_deg == 90.0
    mirror_seen = source.angle_rad <= acceptance
    return Readout(
        source,
        Tally() if whole else Tally(theta_edges=(0.0, acceptance)),
        half_width_mm,
        np.array([[weight]]),
        weight if specular and mirror_seen else 0.0,
        mirror_seen,
    )


def _sphere(sphere: IntegratingSphere) -> Readout:
    half = None if sphere.sample_side_mm == "infinite" else sphere.sample_side_mm / 2
    return Readout(
        Source.collimated(math.radians(sphere.incidence_deg), disc_radius_mm=sphere.beam_diameter_mm / 2),
        Tally() if sphere.port_diameter_mm == "infinite" else Tally(radius_edges=(0.0, sphere.port_diameter_mm / 2)),
        half,
        np.ones((1, 1)),
        float(sphere.specular == "included"),
        True,
    )


def _probe(probe: FibreProbe, n_above: FloatArray) -> Readout:
    n = float(np.mean(n_above))
    notes = []
    if np.ptp(n_above) > 1e-3 * n:
        notes.append("the probe's cone is that of the mean index above: it varies by more than 0.1 % over the band")
    sine = probe.numerical_aperture / n
    reach = probe.source_radius_mm + probe.fibre_radius_mm
    edges = np.linspace(max(0.0, probe.distance_mm - reach), probe.distance_mm + reach, PROBE_BINS + 1)
    return Readout(
        Source.collimated(),
        Tally(
            theta_edges=() if sine >= 1.0 else (0.0, math.asin(sine)),
            radius_edges=tuple(float(x) for x in edges),
        ),
        None,
        probe_weights(probe, edges)[None, :],
        0.0,
        False,
        tuple(notes),
    )


def probe_weights(probe: FibreProbe, edges_mm: FloatArray) -> FloatArray:
    """(R,) chance that light which leaves at a distance from where it entered hits the detector fibre.

    Light enters evenly over the source fibre and leaves at distance r in any direction alike, so the chance is
    the mean over that direction of the overlap of the detector with the source fibre moved by r. It is averaged
    over each bin, as if the flux were even within it.

    Parameters
    ----------
    probe
        The fibres.
    edges_mm
        (R + 1,) rising distances.
    """
    nodes, node_weights = np.polynomial.legendre.leggauss(6)
    low, high = edges_mm[:-1, None], edges_mm[1:, None]
    r = (low + high) / 2 + (high - low) / 2 * nodes
    d, a, s = probe.distance_mm, probe.fibre_radius_mm, probe.source_radius_mm
    if s == 0.0:
        cosine = (d * d + r * r - a * a) / np.maximum(2 * d * r, np.finfo(float).tiny)
        chance = np.arccos(np.clip(cosine, -1.0, 1.0)) / math.pi
    else:
        # Only directions within ±widest can reach the detector; midpoints of 400 equal parts of that range.
        widest = math.asin(min(1.0, (a + s) / d)) if d > a + s else math.pi / 2
        phi = (np.arange(400) + 0.5) / 400 * widest
        apart = np.sqrt(np.maximum(d * d + r[..., None] ** 2 - 2 * d * r[..., None] * np.cos(phi), 0.0))
        chance = _overlap(apart, a, s).mean(axis=-1) / (math.pi * s * s) * widest / math.pi
    return np.asarray(chance @ node_weights / 2, dtype=np.float64)


def _overlap(apart: FloatArray, a: float, b: float) -> FloatArray:
    """Area that two discs of radii a and b share, their centres `apart`."""
    full = math.pi * min(a, b) ** 2
    x = np.clip(apart, max(abs(a - b), 1e-300), a + b)
    first = np.arccos(np.clip((x * x + a * a - b * b) / (2 * x * a), -1.0, 1.0))
    second = np.arccos(np.clip((x * x + b * b - a * a) / (2 * x * b), -1.0, 1.0))
    kite = np.sqrt(np.maximum((-x + a + b) * (x + a - b) * (x - a + b) * (x + a + b), 0.0)) / 2
    area = a * a * first + b * b * second - kite
    return np.where(apart >= a + b, 0.0, np.where(apart <= abs(a - b), full, area))
