"""A planned scene differs from the full one by less than the tolerance: random tissues, bands, instruments, tolerances.

Endless scenes are checked by adding–doubling at twice the planner's nodes, exactly; scenes with sides by a walk of
both, to three standard errors. A planner that does not verify groups must fail the same check.
"""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from livlab.acquire.instruments.collinear import Collinear
from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
from livlab.acquire.instruments.integrating_sphere import IntegratingSphere
from livlab.acquire.instruments.solvers import WalkSolver
from livlab.acquire.instruments.spectrometer import measure
from livlab.effects import plan as planning
from livlab.effects.plan import Bounds, plan
from livlab.effects.scene import OpticalScene
from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.phase.functions import HenyeyGreenstein
from livlab.model.tissue.readings import reading
from livlab.model.tissue.stack import plain_stack
from livlab.model.tissue.tissue import Tissue
from livlab.model.transport.adding_doubling import adding_doubling

QUIET = [HealthCheck.too_slow, HealthCheck.data_too_large]
SPHERES = reading("consistent", fibre_density="sphere")


def log_uniform(low, high):
    return st.floats(math.log(low), math.log(high)).map(math.exp)


@st.composite
def elements(draw, *, scatters):
    made = {
        "pigment": {
            "kind": "law_absorber",
            "fraction": 0.5,
            "law": "power",
            "scale_per_cm": draw(log_uniform(0.01, 50.0)),
            "reference_nm": 550.0,
            "exponent": draw(st.floats(-4.0, 4.0)),
        }
    }
    if draw(st.booleans()):
        made["blood"] = {
            "kind": "blood",
            "fraction": draw(log_uniform(1e-4, 0.1)),
            "oxygenation": draw(st.floats(0.0, 1.0)),
            "vessel_radius_um": draw(st.sampled_from([0.0, 5.0, 50.0])),
        }
    if scatters:
        kinds = draw(st.sampled_from([("cell",), ("power",), ("cell", "power"), ("power", "fibre")]))
        if "cell" in kinds:
            made["cell"] = {
                "kind": "cell",
                "fraction": draw(st.floats(0.01, 0.8)),
                "a_um": 20.0,
                "b_um": 30.0,
                "albedo": draw(st.sampled_from([1.0, 0.99])),
                "anisotropy": draw(st.floats(0.0, 0.97)),
            }
        if "power" in kinds:
            made["power"] = {
                "kind": "power_law_scatterer",
                "a_per_cm": draw(log_uniform(0.1, 60.0)),
                "b": draw(st.floats(0.0, 3.0)),
                "anisotropy": draw(st.floats(-0.3, 0.97)),
            }
        if "fibre" in kinds:
            made["fibre"] = {"kind": "fibre", "volume_fraction": 0.02, "diameter_um": 0.4, "index": 1.55, "law": "mie"}
    return made


@st.composite
def tissues(draw):
    count = draw(st.integers(1, 4))
    index = draw(st.sampled_from([1.0, 1.33, 1.38, 1.5]))
    layers = []
    for k in range(count):
        last = k == count - 1
        if draw(st.integers(0, 2)) == 0:
            index = draw(st.floats(1.2, 1.6))
        thickness = draw(log_uniform(1.0, 200.0) | st.just(math.inf)) if last else draw(log_uniform(1e-3, 2.0))
        layer = {
            "name": f"layer {chr(97 + k)}",
            "thickness_mm": thickness,
            "index": index,
            "elements": draw(elements(scatters=last or draw(st.integers(0, 4)) > 0)),
        }
        if "fibre" in layer["elements"] and not last and draw(st.booleans()):
            layer["profile"] = [
                {"to": 0.4, "fractions": {"fibre": 0.05}},
                {"to": 1.0, "fractions": {"fibre": draw(st.sampled_from([0.05, 0.001]))}},
            ]
        layers.append(layer)
    return Tissue.parse({"name": "random", "layers": layers})


bands = st.lists(st.floats(460.0, 700.0), min_size=1, max_size=3, unique=True).map(sorted)
tolerances = log_uniform(1e-4, 3e-2)
endless = st.one_of(
    st.builds(
        Collinear,
        sample_side_mm=st.just("infinite"),
        acceptance_deg=st.sampled_from([15.0, 30.0, 90.0]),
        specular=st.sampled_from(["excluded", "included"]),
    ),
    st.builds(
        HyperspectralCamera,
        illumination_deg=st.floats(0.0, 60.0),
        polarisation=st.sampled_from(["none", "crossed"]),
        acceptance_deg=st.sampled_from([10.0, 20.0]),
    ),
    st.builds(
        IntegratingSphere, port_diameter_mm=st.just("infinite"), specular=st.sampled_from(["excluded", "included"])
    ),
)
with_sides = st.one_of(
    st.builds(Collinear, sample_side_mm=st.sampled_from([10.0, 60.0, 300.0]), beam=st.just("pencil")),
    st.builds(Collinear, sample_side_mm=st.sampled_from([10.0, 1000.0]), beam=st.just("face")),
    st.builds(IntegratingSphere, port_diameter_mm=st.sampled_from([10.0, 60.0]), beam_diameter_mm=st.just(3.0)),
)


def exact(stack, instrument, nodes=36):
    """The reading of an endless scene at twice the planner's nodes, and how far it is from 24."""
    view = instrument.readout(stack.n_above)
    mu0 = math.cos(view.source.angle_rad)
    values = [view.of_endless(adding_doubling(stack, mu0=mu0, nodes=n, tolerance=1e-6)) for n in (24, nodes)]
    return values[1], np.abs(values[1] - values[0])


def moved_by_plan(tissue, band, instrument, tolerance):
    """Tolerances by which a planned endless scene moves, after checking it; None if nothing was dropped."""
    stack = optical_stack(tissue, SPHERES, band)
    made = plan(stack, instrument, tolerance, tissue=tissue, reading=SPHERES)
    if not made.dropped:
        return None
    full, error = exact(stack, instrument)
    reduced, other = exact(made.apply(stack), made.instrument)
    apart = np.abs(full - reduced)
    print(f"dropped {made.dropped}, bound {made.bound:.3g}, moved {apart.max():.3g}, tolerance {tolerance:.3g}")
    assert (apart <= min(tolerance, made.bound) + error + other).all()
    return float(apart.max() / tolerance)


def moved_by_walks(tissue, band, instrument, tolerance):
    """The same for scenes with sides, by walks of the full and of the planned scene.

    Power: three standard errors of the difference forgive no more than the tolerance itself.
    """
    stack = optical_stack(tissue, SPHERES, band)
    made = plan(stack, instrument, tolerance, tissue=tissue, reading=SPHERES)
    if not made.dropped:
        return None
    for attempt in range(2):
        # By chance 1 in 370 lies beyond 3 standard errors: such a scene is walked again, independently and to a third
        # of the error, and must then hold.
        solver = WalkSolver(standard_error=tolerance / 4.3 / 3**attempt, pilot=20_000, seed=1 + attempt)
        full = measure(stack, instrument, solver)
        reduced = measure(made.apply(stack), made.instrument, solver.model_copy(update={"seed": 11 + attempt}))
        error = np.hypot(full.standard_error, reduced.standard_error).to_numpy()
        apart = np.abs(full.value - reduced.value).to_numpy()
        print(f"dropped {made.dropped}, moved {apart.max():.3g} ± {error.max():.2g}, tolerance {tolerance:.3g}")
        assert (error <= tolerance / 3).all()
        if (apart <= tolerance + 3 * error).all():
            return float(apart.max() / tolerance)
    raise AssertionError(f"{made.dropped}: moved by {apart}, tolerance {tolerance}, standard error {error}")


def over_scenes(count, check, *strategies):
    """What a check returns over so many random scenes, those that dropped nothing left out."""
    found = []

    # The scene that fails is printed as it is: to shrink it would plan and walk a thousand more.
    @settings(max_examples=count, suppress_health_check=QUIET, database=None, phases=[Phase.generate])
    @given(st.tuples(*strategies))
    def one(scene):
        found.append(check(*scene))

    one()
    return [x for x in found if x is not None]


def test_planned_endless_scenes_stay_within_the_tolerance():
    assert len(over_scenes(6, moved_by_plan, tissues(), bands, endless, tolerances)) >= 2


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_two_hundred_planned_endless_scenes_stay_within_the_tolerance():
    moved = over_scenes(200, moved_by_plan, tissues(), bands, endless, tolerances)
    assert len(moved) >= 100
    # The planner uses what it is given: some scenes move by most of the tolerance.
    assert max(moved) > 0.8


def test_planned_scenes_with_sides_stay_within_the_tolerance(libllvm):
    scenes = (tissues(), bands, with_sides, log_uniform(1e-2, 5e-2))
    assert len(over_scenes(6, moved_by_walks, *scenes)) >= 1


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_two_hundred_planned_scenes_with_sides_stay_within_the_tolerance(libllvm):
    scenes = (tissues(), bands, with_sides, log_uniform(5e-3, 5e-2))
    assert len(over_scenes(200, moved_by_walks, *scenes)) >= 40


def layered(g=0.95):
    """Three alike layers, in each of which the same effect moves the value by as much."""
    return plain_stack(
        [(1.38, 0.4, 30.0, 0.1, HenyeyGreenstein(g)), (1.38, 0.4, 30.0, 0.15, HenyeyGreenstein(g - 0.01)),
         (1.38, 0.4, 30.0, 100.0, HenyeyGreenstein(g - 0.02))]
    )  # fmt: skip


def test_a_planner_that_does_not_verify_groups_fails_the_check(monkeypatch):
    stack, camera = layered(), HyperspectralCamera()
    names = [f"layer-{k}-small-angles-90" for k in range(3)]
    singles = Bounds(OpticalScene(stack, camera), planning.catalogue(OpticalScene(stack, camera)))
    tolerance = 1.05 * max(singles.worst(frozenset({n})) for n in names)

    def moved(made):
        full, error = exact(stack, camera)
        reduced, other = exact(made.apply(stack), made.instrument)
        return float(np.max(np.abs(full - reduced) - error - other))

    assert moved(plan(stack, camera, tolerance)) <= tolerance
    sound = Bounds.worst

    def unverified(self, dropped):
        return max((sound(self, frozenset({n})) for n in dropped), default=0.0)

    monkeypatch.setattr(Bounds, "worst", unverified)
    broken = plan(stack, camera, tolerance)
    assert len(broken.dropped) > 1
    assert moved(broken) > tolerance


@pytest.mark.parametrize("beam", ["pencil", "face"])
@pytest.mark.parametrize("side_mm", [2.0, 6.0])
def test_what_walks_lose_sideways_is_below_its_bound(libllvm, side_mm, beam):
    from livlab.effects.lateral import missed
    from livlab.effects.plane import plane_value

    for stack in (plain_stack([(1.4, 0.5, 20.0, 50.0, HenyeyGreenstein(0.9))]), layered(0.8)):
        instrument = Collinear(sample_side_mm=side_mm, beam=beam, acceptance_deg=90.0)
        value = plane_value(stack, instrument)
        bound = float(missed(OpticalScene(stack, instrument), value)[0])
        finite = measure(stack, instrument, WalkSolver(samples=300_000, seed=3))
        gone = float(value.fine[0] - finite.value[0])
        error = float(finite.standard_error[0])
        assert gone <= bound + 3 * error
        assert 0.0 <= bound <= float(value.scattered[0]) + 1e-12
        # The bound says something: it is not the whole reading, save where nearly all may be lost.
        assert bound < 0.9 * float(value.fine[0]) or side_mm == 2.0
