"""The rest of a layer: one element's fraction is what the others of its budget leave."""

import numpy as np
import pytest

import livlab
from livlab.errors import ConfigError
from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import READINGS, reading
from livlab.model.tissue.tissue import Tissue, override

BLOOD = "layers.dermis.elements.blood.fraction"
BASELINE = "layers.dermis.elements.baseline.fraction"
REST = {"layers.dermis.rest": "baseline"}


def fraction(tissue, layer, element):
    return next(x for x in tissue.layers if x.name == layer).elements[element].share


@pytest.mark.parametrize("blood", [0.0, 0.002, 0.05, 0.4, 1.0])
def test_the_rest_is_the_same_as_both_fractions_by_hand(blood):
    by_rest = load_preset("skin", changes={**REST, BLOOD: blood})
    by_hand = load_preset("skin", changes={BLOOD: blood, BASELINE: 1.0 - blood})
    grid = [450.0, 560.0, 700.0]
    a, b = (optical_stack(t, READINGS["measured"], grid) for t in (by_rest, by_hand))
    np.testing.assert_allclose(a.layers[1].absorption, b.layers[1].absorption, rtol=1e-13)
    assert Tissue.model_validate(by_rest.model_dump()) == by_rest


def test_it_follows_each_change_in_whatever_order():
    tissue = load_preset("skin", changes={BLOOD: 0.005})
    tissue = override(override(tissue, REST), {BLOOD: 0.03})
    assert fraction(tissue, "dermis", "baseline") == pytest.approx(0.97)
    assert fraction(override(tissue, {"layers.dermis.rest": ""}), "dermis", "baseline") == pytest.approx(0.97)
    assert override(override(tissue, {"layers.dermis.rest": ""}), {BASELINE: 0.5}).layers[1].rest is None


@pytest.mark.parametrize("path", [BASELINE, "layers.1.elements.baseline.fraction"])
def test_a_fraction_that_follows_cannot_be_set(path):
    with pytest.raises(ConfigError, match=r"takes the rest of dermis.*layers.dermis.rest = ''"):
        load_preset("skin", changes={**REST, path: 0.5})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"layers.dermis.rest": "basline"}, r"is no element of layer dermis\. Did you mean 'baseline'"),
        ({"layers.dermis.rest": "structure"}, r"has no volume fraction\. Name one of blood, baseline"),
        ({**REST, BLOOD: 1.2}, "fraction = 1.2"),
        ({BLOOD: 0.05}, r"by 0.04 in all.*layers\.dermis.rest = 'baseline'"),
    ],
)
def test_what_cannot_take_the_rest_is_refused(changes, message):
    with pytest.raises(ConfigError, match=message):
        load_preset("skin", changes=changes)


def test_where_the_others_alone_pass_one_no_rest_is_advised():
    melanin = {"layers.epidermis.elements.blood": load_preset("skin").layers[1].elements["blood"].model_dump()}
    over = {"layers.epidermis.elements.blood.fraction": 0.5, "layers.epidermis.elements.melanosomes.fraction": 0.7}
    with pytest.raises(ConfigError, match=r"fractions of epidermis = 1.2.*by 0.2 in all\)\.$"):
        load_preset("skin", changes={"layers.epidermis.rest": "baseline", **melanin, **over})


def test_sublayers_have_a_rest_each():
    water = {"kind": "fibre", "diameter_um": 1.0, "index": 1.4, "law": "mie"}  # says no fraction: it takes the rest
    tissue = load_preset("liver", changes={"layers.capsule.elements.ground": water, "layers.capsule.rest": "ground"})
    shares = [sum(e.share for e in x.elements.values()) for x in tissue.layers[0].flat()]
    np.testing.assert_allclose(shares, 1.0, rtol=1e-15)
    assert tissue.layers[0].flat()[0].elements["ground"].share == pytest.approx(1.0 - 0.051 - 0.192)


def test_a_reading_that_changes_another_fraction_changes_the_rest():
    tissue = load_preset("liver", changes={"layers.parenchyma.rest": "lipid_and_water"})
    assert fraction(tissue, "parenchyma", "lipid_and_water") == pytest.approx(1.0 - 0.084 - 0.039)
    prose = tissue.under(reading("measured", lipid_bile="prose"))
    assert fraction(prose, "parenchyma", "lipid_and_water") == pytest.approx(1.0 - 0.084 - 0.019)
    mine = load_preset("liver", changes={"layers.parenchyma.rest": "bile"})
    assert fraction(mine.under(reading("measured", lipid_bile="prose")), "parenchyma", "bile") == pytest.approx(0.137)


def test_an_element_that_a_reading_leaves_out_takes_no_rest():
    tissue = load_preset("liver", changes={"layers.parenchyma.rest": "hepatocyte"})
    assert tissue.under(READINGS["measured"]).layers[1].rest is None
    assert tissue.under(READINGS["consistent"]).layers[1].elements["hepatocyte"].share == 1.0


def test_a_spectrum_says_what_to_do_about_a_full_layer():
    with pytest.raises(ConfigError, match=r"blood 0.05, baseline 0.99.*layers.dermis.rest = 'baseline'"):
        livlab.spectrum("skin", wavelengths_nm=[600.0], changes={BLOOD: 0.05})
    found = livlab.spectrum("skin", wavelengths_nm=[600.0], changes={**REST, BLOOD: 0.05}, solver="adding-doubling")
    assert 0 < found.value[0] < 1
