"""Presets: the liver's numbers, states, variants and bad files."""

import re
import tomllib
from importlib import resources

import pytest
import tomli_w

from livlab import datasets
from livlab.errors import ConfigError
from livlab.model.tissue.optics import coefficients, optical_stack
from livlab.model.tissue.presets import Preset, TissueSpec, load_preset, preset_names, read_preset
from livlab.model.tissue.readings import READINGS, reading

SKIN = """
default_state = "normal"
[states.normal]
[states.tanned.set]
"layers.epidermis.elements.melanin.fraction" = 0.2
[tissue]
name = "skin"
[[tissue.layers]]
name = "epidermis"
thickness_mm = 0.06
index = { kind = "cauchy", coefficients = [1.43, 0.004], valid_nm = [400, 1000] }
[tissue.layers.elements.melanin]
kind = "law_absorber"
fraction = 0.05
law = "power"
scale_per_cm = 680.0
reference_nm = 500.0
exponent = 3.33
[tissue.layers.elements.baseline]
kind = "law_absorber"
fraction = 0.7
law = "exponential"
scale_per_cm = 0.458
reference_nm = 500.0
decay_nm = 66.2
offset_per_cm = 0.244
[tissue.layers.elements.keratin]
kind = "power_law_scatterer"
a_per_cm = 68.7
b = 1.16
anisotropy = 0.8
[[tissue.layers]]
name = "dermis"
thickness_mm = inf
index = 1.4
[tissue.layers.elements.blood]
kind = "blood"
fraction = 0.002
oxygenation = 0.75
vessel_radius_um = 10.0
[tissue.layers.elements.matrix]
kind = "power_law_scatterer"
a_per_cm = 45.3
f_ray = 0.292
b_mie = 0.685
anisotropy = 0.8
"""


def table71():
    table = datasets.load("nunes2019_table71").table.set_index("symbol")["value"]
    return table.dropna().to_dict()


def test_the_liver_holds_table_7_1():
    capsule, parenchyma = load_preset("liver").layers
    blood, lipid = parenchyma.elements["blood"], parenchyma.elements["lipid_and_water"]
    cell = parenchyma.elements["hepatocyte"]
    held = {
        "d_collagen": capsule.elements["collagen"].diameter_um,
        "d_elastin": capsule.elements["elastin"].diameter_um,
        "eta_collagen": capsule.elements["collagen"].index,
        "eta_elastin": capsule.elements["elastin"].index,
        "eta_med": capsule.index,
        "f_blood": blood.fraction,
        "S_tO2": blood.oxygenation,
        "R": blood.vessel_radius_um,
        "f_LA": lipid.fraction,
        "f_L": lipid.parts["lipid"].share,
        "f_bile": parenchyma.elements["bile"].fraction,
        "f_hepatocyte": cell.fraction,
        "a": cell.a_um,
        "b": cell.b_um,
    }
    assert held == table71()


def test_the_capsule_holds_table_6_1():
    table = datasets.load("nunes2019_table61").table
    flat = load_preset("liver").layers[0].flat()
    assert len(flat) == len(table)
    assert sum(x.thickness_mm for x in flat) == pytest.approx(0.085, rel=1e-14)
    for layer, row in zip(flat, table.itertuples(), strict=True):
        assert layer.elements["elastin"].volume_fraction == row.elastin_volume_fraction
        assert layer.elements["collagen"].volume_fraction == row.collagen_volume_fraction
        share = (row.depth_to_percent - row.depth_from_percent) / 100
        assert layer.thickness_mm == pytest.approx(0.085 * share, rel=1e-12)


@pytest.mark.parametrize("state", ["steatosis", "in_vivo"])
def test_states_set_what_the_thesis_sets_and_nothing_else(state):
    table = datasets.load("nunes2019_states").table
    printed = table[table["state"] == state].set_index("symbol")["value"].to_dict()
    before, after = load_preset("liver").layers[1].elements, load_preset("liver", state=state).layers[1].elements
    held = {
        "f_blood": after["blood"].fraction,
        "S_tO2": after["blood"].oxygenation,
        "R": after["blood"].vessel_radius_um / 1e4,
        "f_L": after["lipid_and_water"].parts["lipid"].share,
        "f_bile": after["bile"].fraction,
    }
    was = {
        "f_blood": before["blood"].fraction,
        "S_tO2": before["blood"].oxygenation,
        "R": before["blood"].vessel_radius_um / 1e4,
        "f_L": before["lipid_and_water"].parts["lipid"].share,
        "f_bile": before["bile"].fraction,
    }
    assert held == pytest.approx(was | printed)


def test_the_radius_in_vivo_follows_its_unit_and_a_user_overrules_it():
    def radius(tissue, unit):
        return (
            tissue.under(reading("thesis", in_vivo_vessel_radius_unit=unit))
            .layers[1]
            .elements["blood"]
            .vessel_radius_um
        )

    living = load_preset("liver", state="in_vivo")
    assert [radius(living, u) for u in ("cm", "mm", "um")] == [40.0, 4.0, 0.004]
    assert radius(load_preset("liver"), "mm") == 50.0
    mine = load_preset("liver", state="in_vivo", changes={"layers.parenchyma.elements.blood.vessel_radius_um": 7.0})
    assert radius(mine, "mm") == 7.0


def test_a_state_overrules_a_reading_and_a_user_overrules_both():
    path = "layers.parenchyma.elements.blood.fraction"
    lean = reading("consistent", blood_fraction=0.034)

    def fraction(**how):
        return load_preset("liver", **how).under(lean).layers[1].elements["blood"].fraction

    assert fraction() == 0.034
    assert fraction(state="steatosis") == 0.004
    assert fraction(changes={path: 0.05}) == 0.05
    assert fraction(state="steatosis", changes={path: 0.05}) == 0.05


def test_prose_gives_lipid_and_bile_as_volumes_of_the_liver():
    elements = load_preset("liver").under(reading("consistent", lipid_bile="prose")).layers[1].elements
    lipid = elements["lipid_and_water"]
    assert lipid.fraction * lipid.shares()["lipid"] == pytest.approx(0.039, rel=1e-14)
    assert elements["bile"].fraction == 0.019


@pytest.mark.parametrize(
    ("variant", "layers"),
    [("whole", ["capsule", "parenchyma"]), ("capsule_only", ["capsule"]), ("parenchyma_only", ["parenchyma"])],
)
@pytest.mark.parametrize("state", ["ex_vivo", "in_vivo", "steatosis"])
def test_every_state_and_variant_runs_under_every_reading(state, variant, layers):
    tissue = load_preset("liver", state=state, variant=variant)
    assert [x.name for x in tissue.layers] == layers
    for made in (READINGS["thesis"], reading("measured", fibre_density="sphere", published_scattering="parsa1989")):
        stack = optical_stack(tissue, made, [500.0, 700.0])
        assert len(stack.layers) == (4 if "capsule" in layers else 0) + ("parenchyma" in layers)


def test_another_organ_is_a_file(tmp_path):
    path = tmp_path / "skin.toml"
    path.write_text(SKIN, encoding="utf-8")
    found = coefficients(load_preset(path, state="tanned"), READINGS["measured"], [500.0, 1000.0])
    melanin = found.absorption.sel(layer="epidermis", element="melanin")
    assert melanin.values == pytest.approx([0.2 * 68.0, 0.2 * 68.0 / 2**3.33], rel=1e-12)
    baseline = found.absorption.sel(layer="epidermis", element="baseline")
    assert baseline.values[0] == pytest.approx(0.7 * 0.0702, rel=1e-12)
    matrix = found.scattering.sel(layer="dermis", element="matrix") * 0.2
    assert matrix.values == pytest.approx([4.53, 4.53 * (0.292 / 16 + 0.708 / 2**0.685)], rel=1e-12)


def test_the_presets_come_with_the_package_and_all_of_them_load():
    assert "liver" in preset_names()
    for name in preset_names():
        preset = read_preset(name)
        for state in preset.states:
            assert preset.build(state).state == state


def test_a_preset_written_out_reads_back_equal():
    text = (resources.files("livlab.model.tissue") / "preset_files" / "liver.toml").read_text(encoding="utf-8")
    preset = Preset.model_validate(tomllib.loads(text))
    again = tomli_w.dumps(preset.model_dump(mode="json", exclude_none=True))
    assert Preset.model_validate(tomllib.loads(again)) == preset


@pytest.mark.parametrize("state", ["ex_vivo", "in_vivo"])
def test_a_tissue_resolved_in_a_config_reads_back_equal_and_resolves_once(state):
    spec = TissueSpec.model_validate({"preset": "liver", "state": state, "set": {"layers.capsule.thickness_mm": 0.1}})
    resolved = spec.resolve()
    assert resolved.resolve() == resolved
    text = tomli_w.dumps(resolved.model_dump(mode="json", exclude_none=True))
    back = TissueSpec.model_validate(tomllib.loads(text))
    assert back == resolved
    assert back.build() == spec.build()


def test_an_infinite_layer_survives_the_round_trip(tmp_path):
    path = tmp_path / "skin.toml"
    path.write_text(SKIN, encoding="utf-8")
    resolved = TissueSpec(preset=str(path)).resolve()
    text = tomli_w.dumps(resolved.model_dump(mode="json", exclude_none=True))
    assert TissueSpec.model_validate(tomllib.loads(text)) == resolved


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: load_preset("livr"), "Did you mean 'liver'"),
        (lambda: load_preset("liver", state="exvivo"), "Did you mean 'ex_vivo'"),
        (lambda: load_preset("liver", variant="capsule"), "Did you mean 'capsule_only'"),
        (lambda: load_preset("no/such/file.toml"), "cannot be read"),
    ],
)
def test_what_is_not_there_is_refused_with_a_hint(call, message):
    with pytest.raises(ConfigError, match=message):
        call()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("fraction = 0.05", "fraction = -0.05", r"line 1\d: tissue.layers\[0\].elements.melanin.fraction = -0.05"),
        ("fraction = 0.7", "fraction = 0.99", "must sum to at most 1"),
        ("oxygenation = 0.75", "oxygenation = 75.0", "oxygenation = 75.0.*at most 1"),
        ("oxygenation", "oxigenation", "Did you mean 'oxygenation'"),
        ('kind = "blood"', 'kind = "blod"', "Did you mean 'blood'"),
        ("exponent = 3.33", "decay_nm = 60.0", "needs exponent"),
        ("b_mie = 0.685", "b = 0.685", "Give one form"),
        ("anisotropy = 0.8", "anisotropy = 1.0", "anisotropy = 1.0"),
        ("thickness_mm = 0.06", "thickness_mm = inf", "only the last layer may be infinite"),
        ("thickness_mm = 0.06", "thickness_mm = 0.0", "thickness_mm = 0.0"),
        ("thickness_mm = 0.06", "thickness_mm = nan", "thickness_mm"),
        ('name = "dermis"', 'name = "epidermis"', "two layers have this name"),
        ('name = "dermis"', 'name = "der.mis"', "name = 'der.mis'"),
        ("index = 1.4", "index = 0.0", "index = 0.0"),
        ("index = 1.4", 'index = "1.4"', "index = '1.4'"),
        ("index = 1.4", "index = true", "index = True"),
        ("valid_nm = [400, 1000]", "valid_nm = [1000, 400]", "must rise"),
        ('default_state = "normal"', 'default_state = "norml"', "must be one of normal, tanned"),
        ("[states.normal]", "[states.normal", "not TOML"),
    ],
)
def test_bad_files_are_refused_with_path_value_and_bound(tmp_path, old, new, message):
    assert old in SKIN
    path = tmp_path / "skin.toml"
    path.write_text(SKIN.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ConfigError) as found:
        load_preset(path)
    assert re.search(message, str(found.value)), str(found.value)
    assert str(path) in str(found.value)
