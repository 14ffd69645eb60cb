"""What every instrument answers for itself, and what becomes of one that is new."""

import math
from typing import Literal

import numpy as np
import pytest
from pydantic import Field, TypeAdapter

from livlab.acquire.instruments.base import Edge, Extent, VirtualInstrument, half_mm
from livlab.acquire.instruments.collinear import Collinear
from livlab.acquire.instruments.fibre_probe import FibreProbe
from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
from livlab.acquire.instruments.integrating_sphere import IntegratingSphere
from livlab.acquire.instruments.models import INSTRUMENTS, Instrument
from livlab.acquire.instruments.solvers import AddingDoublingSolver, AutoSolver, TracerSolver, WalkSolver
from livlab.acquire.instruments.spectrometer import measure
from livlab.effects.catalogue import catalogue
from livlab.effects.lateral import missed
from livlab.effects.plane import plane_value, unseen
from livlab.effects.scene import OpticalScene
from livlab.errors import InputError
from livlab.model.tissue.phase.functions import HenyeyGreenstein
from livlab.model.tissue.stack import plain_stack
from livlab.model.transport.geometry import Readout
from livlab.model.transport.source import Source
from livlab.model.transport.tally import Tally

ONE = np.ones(1)
SETTINGS = [
    Collinear(),
    Collinear(beam="pencil", sample_side_mm=3.0),
    Collinear(sample_side_mm="infinite"),
    IntegratingSphere(),
    IntegratingSphere(sample_side_mm=25.0),
    IntegratingSphere(sample_side_mm=25.0, port_diameter_mm="infinite"),
    IntegratingSphere(port_diameter_mm="infinite"),
    FibreProbe(),
    HyperspectralCamera(),
]


class Disc(VirtualInstrument):
    """All light that leaves a small square cuvette, lit in its middle: in no table."""

    kind: Literal["disc"] = "disc"
    side_mm: Extent = Field(2.0, description="Side of the cuvette.")

    def readout(self, n_above):
        return Readout(Source.collimated(), Tally(), half_mm(self.side_mm), np.ones((1, 1)), 0.0, True)

    def edges(self):
        half = half_mm(self.side_mm)
        return () if half is None else (Edge(half, 4, half),)

    def endless(self):
        return self.model_copy(update={"side_mm": "infinite"})

    @property
    def lateral_distance(self):
        return ""

    def endless_notes(self):
        return [] if self.side_mm == "infinite" else ["the cuvette is taken as endless"]

    @classmethod
    def cases(cls):
        return ()


@pytest.mark.parametrize("instrument", [*SETTINGS, Disc(), Disc(side_mm="infinite")], ids=repr)
def test_edges_are_where_the_readout_ends(instrument):
    view = instrument.readout(ONE)
    ends = view.half_width_mm is not None or (bool(view.tally.radius_edges) and not instrument.lateral_distance)
    assert bool(instrument.edges()) == ends
    endless = instrument.endless()
    assert type(endless) is type(instrument)
    assert endless.edges() == ()
    assert endless.readout(ONE).half_width_mm is None
    assert endless.endless() == endless
    assert endless.endless_notes() == []
    assert instrument.scale_free == (not ends and not instrument.lateral_distance)
    assert ("scattering" in instrument.sliders) == instrument.scale_free
    for edge in instrument.edges():
        assert 0.0 < edge.plane_mm <= edge.distance_mm


def test_a_new_instrument_of_finite_size_loses_light_at_its_sides():
    stack = plain_stack([(1.0, 0.1, 5.0, 1.0, HenyeyGreenstein(0.5))])
    finite, endless = (
        measure(stack, Disc(side_mm=side), WalkSolver(samples=20_000, pilot=20_000)) for side in (2.0, "infinite")
    )
    assert float(finite["lost"][0]) > 10 * float(finite["lost_se"][0]) > 0
    assert float(endless["lost"][0]) == 0.0
    scene = OpticalScene(stack, Disc())
    effect = next(e for e in catalogue(scene) if e.name == "lateral-loss")
    assert effect.drop(scene).instrument == Disc(side_mm="infinite")
    assert "lateral-loss" not in [e.name for e in catalogue(effect.drop(scene))]
    bound = missed(scene, plane_value(stack, Disc()))
    lost = float(endless["value"][0] - finite["value"][0])
    assert bound[0] > lost - 4 * math.hypot(*(float(x["standard_error"][0]) for x in (finite, endless)))
    assert unseen(scene) == ""
    assert measure(stack, Disc(), AddingDoublingSolver()).attrs["notes"].endswith("the cuvette is taken as endless")


def test_a_new_instrument_that_needs_distances_is_not_read_without():
    class Far(Disc):
        kind: Literal["far-away"] = "far-away"

        @property
        def lateral_distance(self):
            return "distance of the far away"

    stack = plain_stack([(1.0, 1.0, 9.0, 0.2, HenyeyGreenstein(0.5))])
    with pytest.raises(InputError, match="which a far away needs"):
        measure(stack, Far(), AddingDoublingSolver())
    assert unseen(OpticalScene(stack, Far())).endswith("knows no distance of the far away")


@pytest.mark.parametrize("forgotten", ["readout", "edges", "endless", "lateral_distance", "endless_notes", "cases"])
def test_a_forgotten_method_is_an_error_when_the_class_is_made(forgotten):
    given = {k: v for k, v in vars(Disc).items() if k in Disc.__dict__ and k in _METHODS and k != forgotten}
    with pytest.raises(TypeError, match=f"instrument Half does not define {forgotten}$"):
        type("Half", (VirtualInstrument,), {**given, "__module__": __name__, "__annotations__": {}})


_METHODS = ("readout", "edges", "endless", "lateral_distance", "endless_notes", "cases")


def test_a_field_without_meaning_is_an_error_when_the_class_is_made():
    with pytest.raises(TypeError, match="instrument Mute does not describe size_mm"):

        class Mute(Disc):
            size_mm: float = 1.0


def test_kinds_are_told_apart_by_name():
    kinds = [cls.model_fields["kind"].default for cls in INSTRUMENTS]
    assert len(set(kinds)) == len(kinds)
    for cls, kind in zip(INSTRUMENTS, kinds, strict=True):
        assert type(TypeAdapter(Instrument).validate_python({"kind": kind})) is cls


@pytest.mark.parametrize("cls", INSTRUMENTS)
def test_parameters_have_unit_bounds_and_meaning(cls):
    for row in cls.parameters():
        assert row.meaning.endswith(".")
        assert row.unit == {"mm": "mm", "deg": "°"}.get(row.name.rpartition("_")[2], "")
        assert row.bounds is not None or len(row.words) > 1
        if row.bounds is not None and not isinstance(row.default, str):
            low, high = row.bounds
            assert low <= row.default <= high
            with pytest.raises(ValueError, match=row.name):
                cls.model_validate({row.name: math.nextafter(high, math.inf)})
            with pytest.raises(ValueError, match=row.name):
                cls.model_validate({row.name: low if row.open_below else math.nextafter(low, -math.inf)})
        else:
            assert row.default in row.words
    assert [row.name for row in cls.parameters()] == [name for name in cls.model_fields if name != "kind"]


def test_parameters_by_example():
    rows = {row.name: row for row in Collinear.parameters()}
    side = rows["sample_side_mm"]
    assert (side.unit, side.default, side.bounds, side.open_below, side.words) == (
        "mm", 10.0, (0.0, 1e4), True, ("infinite",),
    )  # fmt: skip
    assert rows["beam"].words == ("face", "pencil")
    assert rows["beam"].bounds is None


def test_what_solvers_answer():
    exact, walk, tracer, auto = AddingDoublingSolver(), WalkSolver(estimator="analog"), TracerSolver(), AutoSolver()
    assert [s.sampled for s in (exact, walk, tracer, auto)] == [False, True, True, False]
    assert [s.is_auto for s in (exact, walk, tracer, auto)] == [False, False, False, True]
    assert [s.literal for s in (exact, walk, tracer, auto)] == [False, True, False, False]
    assert [s.own_seed for s in (exact, walk, WalkSolver(seed=1), AutoSolver(seed=5))] == [None, None, 1, 5]
    assert exact.with_seed(3) == exact
    assert [s.with_seed(3).seed for s in (walk, tracer, auto)] == [3, 3, 3]
