"""A tissue as data: changes by path, checks of the whole, its table."""

import numpy as np
import pytest

from livlab.errors import ConfigError, RangeError
from livlab.model.tissue.presets import TissueSpec, load_preset
from livlab.model.tissue.readings import READINGS, reading
from livlab.model.tissue.spectra import AbsorptionSpectrum, Cauchy, DatasetIndex, refractive_index
from livlab.model.tissue.table import COLUMNS, tissue_table
from livlab.model.tissue.tissue import Tissue, override

LIVER = load_preset("liver")


def minimal(**elements):
    return {"name": "sample", "layers": [{"name": "bulk", "thickness_mm": 1.0, "index": 1.4, "elements": elements}]}


def pigment(fraction, dataset="bile_nachabe2011"):
    return {"kind": "pigment", "fraction": fraction, "spectrum": dataset}


def test_a_change_by_path_changes_that_and_leaves_the_original():
    changed = override(
        LIVER,
        {
            "layers.parenchyma.elements.blood.oxygenation": 0.6,
            "layers.capsule.profile.0.fractions.collagen": 0.3,
            "layers.parenchyma.elements.lipid_and_water.parts.water.spectrum": "water_segelstein1981",
            "n_below": 1.33,
        },
    )
    assert changed.layers[1].elements["blood"].oxygenation == 0.6
    assert changed.layers[0].flat()[0].elements["collagen"].volume_fraction == 0.3
    assert changed.layers[1].elements["lipid_and_water"].parts["water"].spectrum.datasets == ("water_segelstein1981",)
    assert changed.n_below == 1.33
    assert set(changed.given) == {
        "layers.parenchyma.elements.blood.oxygenation",
        "layers.capsule.profile.0.fractions.collagen",
        "layers.parenchyma.elements.lipid_and_water.parts.water.spectrum",
        "n_below",
    }
    assert LIVER.layers[1].elements["blood"].oxygenation == 0.08
    assert LIVER.given == {}


def test_a_profile_from_a_micrograph_replaces_the_capsules():
    profile = [{"to": 0.5, "fractions": {"collagen": 0.1}}, {"to": 1.0, "fractions": {"collagen": 0.2}}]
    flat = override(LIVER, {"layers.capsule.profile": profile}).layers[0].flat()
    assert [x.elements["collagen"].volume_fraction for x in flat] == [0.1, 0.2]
    assert [x.thickness_mm for x in flat] == pytest.approx([0.0425, 0.0425])


def test_an_element_can_be_added_and_taken_by_name():
    water = {"kind": "pigment", "fraction": 0.6, "spectrum": "water_segelstein1981"}
    changed = override(LIVER, {"layers.capsule.elements.water": water})
    assert changed.layers[0].elements["water"].fraction == 0.6
    assert "water_segelstein1981" in changed.dataset_names()


def test_a_reading_does_not_change_back_what_a_user_set():
    mine = override(LIVER, {"layers.capsule.elements.elastin": LIVER.layers[0].elements["elastin"].model_dump()})
    assert LIVER.under(READINGS["consistent"]).layers[0].elements["elastin"].index == 1.534
    assert mine.under(READINGS["consistent"]).layers[0].elements["elastin"].index == 1.5


def test_a_tissue_under_a_reading_has_nothing_left_to_choose():
    for made in READINGS.values():
        once = LIVER.under(made)
        assert once.under(made) == once
        scatterers = {"hepatocyte", "published"} & set(once.layers[1].elements)
        assert scatterers == ({"published"} if made.name == "measured" else {"hepatocyte"})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"layers.parenchyma.elements.blood.oxygenation": 1.2}, r"layers.parenchyma.elements.blood.oxygenation = 1.2"),
        ({"layers.parenchyma.elements.blood.oxygenation": "0.6"}, "oxygenation = '0.6'.*number"),
        ({"layers.parenchyma.elements.blood.oxygenatoin": 0.6}, "unknown key.*Did you mean 'oxygenation'"),
        ({"layers.parenchima.elements.blood.fraction": 0.1}, "has no 'parenchima'.*Did you mean 'parenchyma'"),
        ({"layers.parenchyma.elements.blod.fraction": 0.1}, "has no 'blod'.*Did you mean 'blood'"),
        ({"layers.7.thickness_mm": 0.1}, "has no '7'"),
        ({"layers.parenchyma.thickness_mm.x": 0.1}, "single value"),
        ({"layers..thickness_mm": 0.1}, "has no ''"),
        ({"": 0.1}, "the tissue has no ''"),
        ({"layers.parenchyma.elements.blood.fraction": -0.1}, "fraction = -0.1"),
        ({"layers.parenchyma.elements.blood.fraction": 0.2}, "sum to at most 1.*blood 0.2"),
        ({"layers.parenchyma.elements.blood.fraction": float("nan")}, "finite"),
        ({"layers.capsule.profile.0.fractions.elastin": 0.9}, "fractions of capsule 1 = 1.092"),
        ({"layers.capsule.profile.0.to": 0.9}, "ends must rise to 1"),
        ({"layers.capsule.profile.0.fractions.elastine": 0.1}, "Did you mean 'elastin'"),
        ({"layers.parenchyma.elements.published.replaces": "hepatocytes"}, "Did you mean 'hepatocyte'"),
        ({"layers.parenchyma.elements.lipid_and_water.parts.lipid.share": 1.2}, "share = 1.2"),
        ({"layers.parenchyma.elements.lipid_and_water.parts.lipid.share": None,}, "only one part"),
        ({"layers.capsule.thickness_mm": float("inf")}, "only the last layer"),
        ({"layers": []}, "layers"),
    ],
)  # fmt: skip
def test_bad_changes_are_refused_with_path_value_bound_and_remedy(changes, message):
    with pytest.raises(ConfigError, match=f"(?s){message}") as found:
        override(LIVER, changes)
    assert found.value.remedy or "\n" in found.value.message


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"when": {"lipid_bil": "prose"}, "set": {"n_below": 1.3}}, "Did you mean 'lipid_bile'"),
        ({"when": {"lipid_bile": "prosa"}, "set": {"n_below": 1.3}}, "is no value of the option"),
        ({"when": {"lipid_bile": "prose"}, "set": {"layers.bulk.thicknes_mm.x": 1.3}}, "has no 'thicknes_mm'"),
        ({"when": {}, "set": {"n_below": 1.3}}, "when"),
    ],
)
def test_choices_that_no_reading_can_make_are_refused(choice, message):
    with pytest.raises(ConfigError, match=message):
        Tissue.parse(minimal() | {"choices": [choice]})


def test_a_tissue_inline_stands_for_itself():
    spec = TissueSpec.model_validate({"inline": minimal(bile=pigment(0.5)), "set": {"layers.bulk.thickness_mm": 2.0}})
    assert spec.build().layers[0].thickness_mm == 2.0
    with pytest.raises(ValueError, match="cannot be given beside a preset"):
        TissueSpec.model_validate({"inline": minimal(), "preset": "liver"})


def test_composition_and_structure_are_summed_apart():
    cell = {"kind": "cell", "fraction": 0.8, "a_um": 20.0, "b_um": 30.0, "anisotropy": 0.9}
    Tissue.parse(minimal(cell=cell, bile=pigment(1.0)))
    with pytest.raises(ConfigError, match="must sum to at most 1"):
        Tissue.parse(minimal(a=pigment(0.6), b=pigment(0.5)))
    with pytest.raises(ConfigError, match="must sum to at most 1"):
        Tissue.parse(minimal(a=cell, b=cell))


@pytest.mark.parametrize("name", ["a.b", "a*", "[0]", " a", "a ", ""])
def test_names_that_no_path_can_hold_are_refused(name):
    with pytest.raises(ConfigError, match="name"):
        Tissue.parse(minimal(**{name: pigment(0.1)}))


def test_the_first_dataset_that_covers_a_wavelength_is_used():
    notes = []
    spectrum = AbsorptionSpectrum.model_validate({"datasets": ["water_pope_fry1997", "water_segelstein1981"]})
    pope, segelstein = (AbsorptionSpectrum.model_validate(n) for n in spectrum.datasets)
    mixed = spectrum.per_mm(np.array([900.0, 500.0, 727.5]), notes.append)
    assert mixed[0] == segelstein.per_mm(np.array([900.0]), notes.append)[0]
    assert mixed[1:].tolist() == pope.per_mm(np.array([500.0, 727.5]), notes.append).tolist()
    assert not notes


def test_outside_every_range_is_an_error_or_a_noted_end():
    notes = []
    lipid = {"datasets": ["lipid_vanveen2004"]}
    with pytest.raises(RangeError, match=r"wavelength_nm = 420.*429–1098 nm.*hold"):
        AbsorptionSpectrum.model_validate(lipid).per_mm(np.array([500.0, 420.0]), notes.append)
    held = AbsorptionSpectrum.model_validate(lipid | {"outside": "hold"})
    values = held.per_mm(np.array([420.0, 429.0, 1098.0, 1200.0]), notes.append)
    assert values[0] == values[1]
    assert values[2] == values[3]
    assert len(notes) == 1
    assert "2 wavelength(s)" in notes[0]


def test_the_dispersion_formula_is_the_published_table():
    formula = Cauchy(kind="cauchy", coefficients=(1.3591, 0.00827, -0.000576), valid_nm=(450.0, 1551.0))
    table = DatasetIndex(kind="dataset", dataset="liver_refractive_index_giannios2016")
    wavelength = np.arange(450.0, 1551.0, 3.0)
    notes = []
    one, other = (refractive_index(x, wavelength, notes.append) for x in (formula, table))
    assert np.abs(one - other).max() < 6e-6  # the table has five decimals
    with pytest.raises(RangeError, match="449"):
        refractive_index(formula, np.array([449.0]), notes.append)
    held = formula.model_copy(update={"outside": "hold"})
    assert refractive_index(held, np.array([400.0]), notes.append) == refractive_index(formula, [450.0], notes.append)


def test_the_table_has_every_number_its_unit_and_its_source():
    tissue = load_preset("liver", state="in_vivo", changes={"layers.parenchyma.elements.bile.fraction": 0.01})
    table = tissue_table(tissue, reading("thesis"))
    assert tuple(table.columns) == COLUMNS
    numbers = table[table["value"].map(lambda x: isinstance(x, float))]
    assert (numbers["unit"] != "").all()
    assert (numbers["source"] != "").all(), numbers[numbers["source"] == ""]

    def row(element, parameter):
        return table[(table["element"] == element) & (table["parameter"] == parameter)].iloc[0]

    assert row("blood", "oxygenation")[["value", "source"]].tolist() == [0.9, "set by state in_vivo"]
    assert row("bile", "fraction")[["value", "source"]].tolist() == [0.01, "set by user"]
    assert row("hepatocyte", "geometric attenuation")["value"] == pytest.approx(269.26, abs=0.01)
    assert row("lipid_and_water", "water share")["value"] == pytest.approx(0.981)
    assert table[table["layer"] == "parenchyma"]["n_500nm"].iloc[0] == pytest.approx(1.383, abs=1e-4)
    assert "published" not in set(table["element"])
