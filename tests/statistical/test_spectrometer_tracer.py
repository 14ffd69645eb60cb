"""The virtual spectrometer on the tracer against the walk in plane layers and adding–doubling.

Each z within 4; the standard errors' sizes are bounded, so that a bias of a few per cent fails.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from livlab.acquire.instruments.collinear import Collinear
from livlab.acquire.instruments.fibre_probe import FibreProbe
from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
from livlab.acquire.instruments.integrating_sphere import IntegratingSphere
from livlab.acquire.instruments.models import Instrument
from livlab.acquire.instruments.solvers import AddingDoublingSolver, TracerSolver, WalkSolver
from livlab.acquire.instruments.spectrometer import measure
from livlab.errors import InputError
from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.phase.functions import HenyeyGreenstein
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import READINGS
from livlab.model.tissue.stack import OpticalStack, plain_stack

GRID = [500.0, 600.0, 720.0]


def liver(reading: str, part: str = "whole") -> OpticalStack:
    return optical_stack(load_preset("liver", variant=part), READINGS[reading], GRID)


def agree(stack: OpticalStack, instrument: Instrument, other: Any, relative: float, power: float) -> Any:
    ours = measure(stack, instrument, TracerSolver(relative=relative, seed=5))
    theirs = measure(stack, instrument, other)
    assert ours["converged"].all()
    assert "given up" not in ours.attrs["notes"]
    error = np.hypot(ours["standard_error"], theirs["standard_error"])
    assert (error <= power * theirs["value"].max()).all(), (error / theirs["value"].max()).to_numpy()
    z = ((ours["value"] - theirs["value"]) / error).to_numpy()
    assert np.abs(z).max() < 4.0, z
    return ours


@pytest.mark.parametrize(
    ("reading", "part"),
    [
        ("thesis", "parenchyma_only"),
        ("measured", "parenchyma_only"),
        pytest.param("thesis", "whole", marks=pytest.mark.slow),
        pytest.param("measured", "whole", marks=pytest.mark.slow),
    ],
)
def test_the_thesiss_block_reads_as_in_plane_layers(reading: str, part: str) -> None:
    """1 cm², light and sensor along the normal: what leaves through the sides is lost in both."""
    walk = WalkSolver(relative=0.012, seed=2)
    agree(liver(reading, part), Collinear(), walk, 0.012, 0.018)


@pytest.mark.parametrize(
    "instrument",
    [
        Collinear(sample_side_mm="infinite", beam="pencil", specular="included"),
        HyperspectralCamera(illumination_deg=45.0),
        IntegratingSphere(port_diameter_mm="infinite", incidence_deg=8.0),
    ],
)
def test_an_endless_sample_reads_as_adding_doubling_has_it(instrument: Instrument) -> None:
    stack = plain_stack([(1.35, 0.01, 10.0, 0.1, HenyeyGreenstein(0.7)), (1.4, 0.8, 8.0, 40.0, HenyeyGreenstein(0.7))])
    agree(stack, instrument, AddingDoublingSolver(), 0.005, 0.006)


def test_a_probe_and_a_small_port_read_as_in_plane_layers() -> None:
    stack = plain_stack([(1.4, 0.8, 8.0, 40.0, HenyeyGreenstein(0.7))])
    probe = FibreProbe(distance_mm=0.5, source_radius_mm=0.2, fibre_radius_mm=0.2, numerical_aperture=1.0)
    agree(stack, probe, WalkSolver(relative=0.02, seed=2), 0.02, 0.03)
    port = IntegratingSphere(port_diameter_mm=3.0, beam_diameter_mm=2.0, sample_side_mm=8.0)
    agree(stack, port, WalkSolver(relative=0.004, seed=2), 0.004, 0.006)


def test_what_was_measured_is_gone_on_from() -> None:
    stack, solver = liver("thesis", "parenchyma_only"), TracerSolver(samples=12_000, launch=4096, seed=3)
    rounds: list[Any] = []
    whole = measure(stack, Collinear(), solver, on_round=lambda part, p: rounds.append((part, p)))
    assert [p.samples for _, p in rounds] == [4096, 8192, 12288]
    assert rounds[-1][1].done == 1.0
    again = measure(stack, Collinear(), solver, resume=rounds[0][0])
    for name in ("value", "standard_error"):
        np.testing.assert_allclose(again[name], whole[name], rtol=1e-9)
    with pytest.raises(InputError, match="seed"):
        measure(stack, Collinear(), TracerSolver(samples=12_000, seed=4), resume=rounds[0][0])


def test_what_it_cannot_do_is_refused() -> None:
    thin = plain_stack([(1.4, 0.1, 5.0, 0.5, HenyeyGreenstein(0.7))])
    with pytest.raises(InputError, match="light gets through"):
        measure(thin, Collinear(), TracerSolver())
