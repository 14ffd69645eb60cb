"""Effects one by one: the catalogue, the pure functions that leave them out, forcing, the plan's table, the command."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError
from typer.testing import CliRunner

from livlab.acquire.instruments.collinear import Collinear
from livlab.acquire.instruments.fibre_probe import FibreProbe
from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
from livlab.acquire.instruments.integrating_sphere import IntegratingSphere
from livlab.effects.catalogue import catalogue
from livlab.effects.config import EffectsConfig, forced_effects
from livlab.effects.cost import mean_steps, predicted_cost
from livlab.effects.lateral import _layers, _Medium, _one_layer
from livlab.effects.plan import COLUMNS, Bounds, plan
from livlab.effects.scene import OpticalScene, groups
from livlab.errors import ConfigError, InputError
from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import READINGS, reading
from livlab.model.tissue.stack import Interaction, PlaneLayer, plain_stack

CAMERA = HyperspectralCamera()
BULK = plain_stack([(1.38, 0.6, 50.0, 140.0, HenyeyGreenstein(0.95))])
SPHERES = reading("consistent", fibre_density="sphere", scattering_phase="isotropic")


def liver(wavelengths=(500.0, 560.0)):
    return optical_stack(load_preset("liver"), SPHERES, wavelengths)


def test_the_catalogue_of_the_liver_names_every_kind_of_effect():
    stack = liver()
    found = catalogue(OpticalScene(stack, Collinear()), load_preset("liver"), SPHERES)
    names = [e.name for e in found]
    assert len(set(names)) == len(names)
    for name in (
        "packaging", "capsule-scattering", "parenchyma-scattering", "collagen", "elastin", "blood", "bile",
        "lipid-and-water", "capsule", "capsule-1", "capsule-4", "parenchyma", "capsule-sublayers", "index-dispersion",
        "interface-capsule-parenchyma", "surface-fresnel", "transmission", "lateral-loss", "surface-roughness",
        "wet-film",
    ):  # fmt: skip
        assert name in names
    # The hepatocyte is all that scatters in the parenchyma: one effect, not two.
    assert "hepatocyte" not in names
    assert {e.name for e in found if e.where == "tracer only"} == {"surface-roughness", "wet-film"}
    assert [e.stage for e in found] == sorted(e.stage for e in found)
    assert all(e.what and e.cost for e in found)


def test_anisotropy_is_an_effect_where_light_is_scattered_forwards():
    names = [e.name for e in catalogue(OpticalScene(BULK, CAMERA))]
    assert {f"layer-0-{x}" for x in ("small-angles-30", "small-angles-60", "small-angles-90", "anisotropy")} <= set(
        names
    )
    isotropic = plain_stack([(1.38, 0.6, 50.0, 140.0, Isotropic())])
    assert not any("anisotropy" in e.name or "angles" in e.name for e in catalogue(OpticalScene(isotropic, CAMERA)))


def test_every_effect_is_a_pure_function_that_changes_its_scene():
    scene = OpticalScene(liver(), Collinear())
    before = [(x.name, x.thickness_mm, x.n.copy(), [i.rate.copy() for i in x.interactions]) for x in scene.stack.layers]
    for e in catalogue(scene, load_preset("liver"), SPHERES):
        if e.drop is None:
            continue
        once = e.drop(scene)
        assert once is not scene
        assert once.stack is not scene.stack or once.instrument != scene.instrument
        # Leaving out what is left out already changes nothing more.
        twice = e.drop(once)
        assert [x.name for x in twice.stack.layers] == [x.name for x in once.stack.layers]
        for a, b in zip(once.stack.layers, twice.stack.layers, strict=True):
            assert np.allclose(a.scattering, b.scattering, rtol=1e-9)
            assert np.allclose(a.absorption, b.absorption, rtol=1e-9)
    after = [(x.name, x.thickness_mm, x.n, [i.rate for i in x.interactions]) for x in scene.stack.layers]
    for a, b in zip(before, after, strict=True):
        assert a[:2] == b[:2]
        assert np.array_equal(a[2], b[2]) and all(np.array_equal(p, q) for p, q in zip(a[3], b[3], strict=True))


def test_packaging_can_be_left_out_only_if_the_tissue_is_known():
    stack = liver()
    tissue = load_preset("liver")
    spread = [e for e in catalogue(OpticalScene(stack, CAMERA), tissue, SPHERES) if e.name == "packaging"]
    assert len(spread) == 1 and spread[0].absorbs_only == 1
    assert not [e for e in catalogue(OpticalScene(stack, CAMERA)) if e.name == "packaging"]
    assert spread[0].drop is not None
    full = stack.layers[-1].absorption
    without = spread[0].drop(OpticalScene(stack, CAMERA)).stack.layers[-1].absorption
    assert (without > 1.1 * full).all()
    # The very stack of the same tissue with vessels of no radius.
    thin = load_preset("liver", changes={"layers.parenchyma.elements.blood.vessel_radius_um": 0.0})
    assert np.allclose(without, optical_stack(thin, SPHERES, stack.wavelength_nm).layers[-1].absorption)


def test_groups_are_numbered_from_one():
    one = np.ones(1)
    names = ["a 1", "a 2", "a 3", "b", "c 2", "c 3", "d 1", "layer 0", "layer 1", "layer 2"]
    found = groups([PlaneLayer(n, 1.0, one) for n in names])
    assert [(g.name, len(g.members)) for g in found] == [
        ("a", 3), ("b", 1), ("c 2", 1), ("c 3", 1), ("d 1", 1), ("layer 0", 1), ("layer 1", 1), ("layer 2", 1)
    ]  # fmt: skip


def test_the_plan_of_a_thick_liver_takes_small_angles_together():
    made = plan(BULK, CAMERA, 0.002)
    assert made.dropped == ("layer-0-small-angles-90",)
    assert 0.0 < made.bound <= 0.002
    assert made.predicted_saving > 0.7
    assert made.apply(BULK).layers[0].scattering[0] < 0.12 * BULK.layers[0].scattering[0]
    assert plan(BULK, CAMERA, 0.002).records() == made.records()
    # A smaller tolerance leaves out less; the value moves by less.
    finer = plan(BULK, CAMERA, 1e-4)
    assert finer.dropped == ("layer-0-small-angles-30",)
    assert finer.bound <= 1e-4 and finer.predicted_saving < made.predicted_saving


def test_the_tolerance_can_be_a_share_of_the_maximum():
    absolute = plan(BULK, CAMERA, 0.002)
    top = float(Bounds(absolute.scene, absolute.effects).value(frozenset()).fine.max())
    relative = plan(BULK, CAMERA, 0.01, tolerance_of="maximum")
    assert relative.tolerance == pytest.approx(0.01 * top)


def test_forcing_goes_before_the_plan():
    on = plan(BULK, CAMERA, 0.002, {"layer-0-small-angles-90": "on"})
    assert "layer-0-small-angles-90" not in on.dropped
    assert on.dropped == ("layer-0-small-angles-60",)
    off = plan(BULK, CAMERA, 0.002, {"surface-fresnel": "off"})
    assert "surface-fresnel" in off.dropped
    row = next(r for r in off.rows if r.effect == "surface-fresnel")
    assert (row.decision, row.why) == ("forced off", "too much")
    assert off.bound > 0.002
    assert np.array_equal(off.apply(BULK).n_above, BULK.layers[0].n)
    none = plan(BULK, CAMERA, 0.002, {"*": "on"})
    assert none.dropped == () and none.bound == 0.0
    every = plan(BULK, CAMERA, 0.002, mode="all")
    assert every.dropped == ()
    one = plan(BULK, CAMERA, 0.002, {"transmission": "off"}, mode="all")
    assert one.dropped == ("transmission",) and math.isinf(one.apply(BULK).layers[0].thickness_mm)


def test_a_pattern_gives_way_to_a_name_and_an_unknown_name_is_refused():
    names = ["capsule", "capsule-1", "blood"]
    assert forced_effects(names, {"capsule*": "off", "capsule-1": "on"}) == {"capsule": "off", "capsule-1": "on"}
    assert forced_effects(names, {"blood": "auto"}) == {}
    with pytest.raises(ConfigError, match="Did you mean 'capsule'"):
        forced_effects(names, {"capsul": "off"})
    with pytest.raises(InputError, match=r"effects\.blood"):
        forced_effects(names, {"blood": "maybe"})


@pytest.mark.parametrize(
    ("data", "mode", "tolerance", "forced"),
    [
        ("auto", "auto", 0.002, {}),
        ("all", "all", 0.002, {}),
        ({"tolerance": 0.01, "capsule": "off"}, "auto", 0.01, {"capsule": "off"}),
        ({"mode": "all", "capsule-*": "on"}, "all", 0.002, {"capsule-*": "on"}),
    ],
)
def test_what_a_file_says_of_effects(data, mode, tolerance, forced):
    found = EffectsConfig.model_validate(data)
    assert (found.mode, found.tolerance, found.forced) == (mode, tolerance, forced)
    assert EffectsConfig.model_validate(found.model_dump()) == found


@pytest.mark.parametrize("data", ["some", {"tolerance": 0.0}, {"tolerance": "x"}, {"capsule": "of"}, {"capsule": 1}, 3])
def test_what_a_file_may_not_say_of_effects(data):
    with pytest.raises(ValidationError):
        EffectsConfig.model_validate(data)


def test_a_scene_that_the_solver_cannot_see_keeps_all_and_says_why():
    probe = plan(BULK, FibreProbe(), 0.002)
    assert probe.dropped == ()
    assert all("fibres" in r.why for r in probe.rows if r.decision == "kept")
    assert math.isnan(next(r for r in probe.rows if r.effect == "surface-fresnel").bound)
    forced = plan(BULK, FibreProbe(), 0.002, {"surface-fresnel": "off"})
    assert forced.dropped == ("surface-fresnel",) and math.isnan(forced.bound)
    steered = replace(BULK.layers[0].interactions[1], redirect="abs_cos")
    stack = replace(BULK, layers=(replace(BULK.layers[0], interactions=(BULK.layers[0].interactions[0], steered)),))
    assert all("redirect" in r.why for r in plan(stack, CAMERA, 0.002).rows if r.decision == "kept")


def test_absorption_by_short_paths_widens_the_bound():
    short = replace(BULK.layers[0].interactions[1], absorb_below_mm=0.001)
    stack = replace(BULK, layers=(replace(BULK.layers[0], interactions=(BULK.layers[0].interactions[0], short)),))
    scene = OpticalScene(stack, CAMERA)
    bounds = Bounds(scene, catalogue(scene))
    assert bounds.short(frozenset()).max() > 1e-3
    assert bounds.worst(frozenset({"transmission"})) >= bounds.short(frozenset()).max()


def test_only_absorption_moves_a_finite_sample_less_than_an_endless_one():
    stack = plain_stack([(1.38, 0.6, 50.0, 140.0, HenyeyGreenstein(0.95))])
    one = np.ones(1)
    dye = Interaction("dye", 1e-4 * one, 0 * one, (Isotropic(),))
    stack = replace(stack, layers=(replace(stack.layers[0], interactions=(*stack.layers[0].interactions, dye)),))
    scene = OpticalScene(stack, Collinear())
    bounds = Bounds(scene, catalogue(scene))
    assert bounds.worst(frozenset({"dye"})) < 1e-4
    assert bounds.worst(frozenset({"transmission"})) >= bounds.missed(frozenset()).max() > 1e-3
    # Beside an effect that is more than absorption it counts in full.
    assert bounds.worst(frozenset({"dye", "transmission"})) >= bounds.missed(frozenset()).max()


def test_lateral_loss_is_dropped_for_a_wide_sample_and_kept_for_a_narrow_one():
    wide = plan(BULK, Collinear(sample_side_mm=60.0, beam="pencil"), 0.002)
    assert "lateral-loss" in wide.dropped
    assert wide.instrument == Collinear(sample_side_mm="infinite", beam="pencil")
    narrow = plan(BULK, Collinear(sample_side_mm=1.0, beam="pencil"), 0.002)
    assert "lateral-loss" not in narrow.dropped and narrow.instrument == Collinear(sample_side_mm=1.0, beam="pencil")
    port = plan(BULK, IntegratingSphere(port_diameter_mm=80.0), 0.002)
    assert "lateral-loss" in port.dropped
    assert isinstance(port.instrument, IntegratingSphere) and port.instrument.port_diameter_mm == "infinite"


def test_decay_of_diffuse_light_sideways_is_the_known_one():
    # Isotropic scattering, albedo c: the largest s with a positive solution obeys c/(2k) ln((1 + k)/(1 − k)) = 1,
    # k = s/µt (Case & Zweifel 1967, section 4.3).
    for c in (0.5, 0.9, 0.99):
        chi = np.eye(1, 49)[0]
        rates = _one_layer(_Medium(1.4, 1.0 - c, c, chi), 0.0)
        largest = rates[-1][0]
        assert c / (2 * largest) * math.log((1 + largest) / (1 - largest)) <= 1.0 + 1e-9
        assert 1.06 * largest > _root(c)
        # The function that serves several layers serves one, less well.
        several = _layers([_Medium(1.4, 1.0 - c, c, chi)], 0.0)
        assert several[-1][0] == pytest.approx(math.sqrt(1.0 - c), rel=0.03)


def _root(c):
    low, high = 1e-9, 1 - 1e-12
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if c / (2 * middle) * math.log((1 + middle) / (1 - middle)) < 1 else (low, middle)
    return low


def test_layers_that_do_not_absorb_give_no_decay_sideways():
    chi = np.eye(1, 49)[0]
    assert _layers([_Medium(1.4, 0.0, 5.0, chi), _Medium(1.4, 1.0, 5.0, chi)], 0.0) == []
    assert _one_layer(_Medium(1.4, 0.0, 5.0, chi), 0.0) == []


def test_predicted_steps_are_those_of_a_walk():
    # Meetings of the literal walk: what absorbs 0.25 at each meeting ends after 4 of them, less what leaves before.
    slab = plain_stack([(1.0, 1.0, 3.0, math.inf, Isotropic())])
    steps = float(mean_steps(slab, 1.0)[0])
    assert 1.0 < steps < 4.0
    assert float(mean_steps(plain_stack([(1.0, 1.0, 0.0, math.inf, Isotropic())]), 1.0)[0]) == pytest.approx(
        1.0, rel=1e-3
    )
    endless, sides = (predicted_cost(OpticalScene(BULK, Collinear(sample_side_mm=x))) for x in ("infinite", 10.0))
    assert endless < sides
    assert predicted_cost(OpticalScene(BULK, CAMERA), literal=True) > predicted_cost(OpticalScene(BULK, CAMERA))


def test_the_table_has_its_columns_and_ends_with_the_group():
    made = plan(BULK, CAMERA, 0.002)
    table = made.table()
    assert tuple(table.columns) == COLUMNS
    assert table.effect.iloc[-1] == "(all that are dropped)" and table.bound.iloc[-1] == made.bound
    assert set(table.decision) <= {"kept", "dropped", "forced on", "forced off", "not applicable"}
    assert table.measured_saving.isna().all()
    assert len(plan(BULK, CAMERA, 1e-9).table()) == len(made.table()) - 1


def test_a_plan_holds_for_its_own_wavelengths_only():
    made = plan(BULK, CAMERA, 0.002)
    with pytest.raises(InputError, match="Plan anew"):
        made.apply(replace(BULK, wavelength_nm=np.array([501.0])))
    for bad in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(InputError, match="tolerance"):
            plan(BULK, CAMERA, bad)


def test_the_command_prints_a_table_and_json(tmp_path):
    from livlab.cli.app import app

    file = tmp_path / "a.toml"
    file.write_text(
        'schema = 1\nkind = "spectral"\nname = "a"\nreadings = ["measured"]\n[tissue]\nvariant = "parenchyma_only"\n'
        '[wavelengths]\nlist_nm = [550.0]\n[instrument]\nkind = "hyperspectral-camera"\n'
    )
    shown = CliRunner().invoke(app, ["plan", str(file), "--tolerance", "0.002"])
    assert shown.exit_code == 0, shown.output
    assert "parenchyma-small-angles-90" in shown.output and "Left out" in shown.output
    printed = CliRunner().invoke(app, ["plan", str(file), "--json"])
    found = json.loads(printed.output)["measured"]
    assert found["dropped"] == ["parenchyma-small-angles-90"]
    assert {e["effect"] for e in found["effects"]} > {"packaging", "blood", "surface-fresnel"}
    assert found["bound"] <= found["tolerance"] == 0.002


def test_measured_savings_are_of_walks(libllvm):
    from livlab.effects.timing import measured, time_pair

    made = measured(plan(BULK, CAMERA, 0.002), seconds=0.5, pairs=2)
    row = next(r for r in made.rows if r.decision == "dropped")
    assert row.measured_saving is not None and made.measured_saving is not None
    # Nine in ten scatterings less: even a busy machine sees it.
    assert made.measured_saving > 0.4
    same = time_pair(made.scene, made.scene, seconds=0.3, pairs=2)
    assert abs(same.saving) < 0.3
    with pytest.raises(InputError, match="pairs"):
        time_pair(made.scene, made.scene, pairs=1)


def test_nothing_to_measure_where_nothing_is_dropped():
    from livlab.effects.timing import measured

    made = plan(BULK, CAMERA, 0.002, {"*": "on"})
    assert measured(made) is made


def test_readings_of_the_thesis_plan_without_trouble():
    stack = optical_stack(load_preset("liver"), READINGS["thesis"], [550.0])
    made = plan(stack, CAMERA, 0.02, tissue=load_preset("liver"), reading=READINGS["thesis"])
    assert made.bound <= 0.02
