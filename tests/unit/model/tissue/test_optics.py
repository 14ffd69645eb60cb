"""From tissue and reading to the stack: rates, phases, warnings and speed."""

import math
import time

import numpy as np
import pytest

from livlab import datasets
from livlab.errors import InputError, RangeError
from livlab.model.tissue.optics import coefficients, optical_stack
from livlab.model.tissue.particles.cylinder import cylinder_mean
from livlab.model.tissue.particles.sphere import mie
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import READINGS, reading

LIVER = load_preset("liver")
WAVELENGTH = np.arange(500.0, 721.0, 20.0)


def element(stack, layer, name):
    found = next(x for x in stack.layers if x.name == layer)
    return next(i for i in found.interactions if i.name == name)


def depth(stack):
    return sum(x.thickness_mm * sum(i.rate for i in x.interactions) for x in stack.layers if "capsule" in x.name)


def test_thesis_walks_with_uniform_directions_and_the_penalised_hepatocyte():
    stack = optical_stack(LIVER, READINGS["thesis"], WAVELENGTH)
    cell = element(stack, "parenchyma", "hepatocyte")
    assert cell.rate == pytest.approx(np.full(12, 0.1 / math.log10(270.26)), rel=1e-5)
    assert cell.albedo.tolist() == [1.0] * 12
    assert cell.absorb_below_mm == pytest.approx(0.025)
    for layer in stack.layers:
        for i in layer.interactions:
            absorbs = i.name in {"blood", "bile", "lipid_and_water"}
            assert i.albedo.tolist() == [0.0 if absorbs else 1.0] * 12
            assert all(isinstance(p, Isotropic) for p in i.phases)
            assert i.redirect == ("none" if absorbs else "abs_cos")
    assert 0.01 < depth(stack).min() < depth(stack).max() < 0.1


def test_thesis_warns_of_the_elastin_efficiency_of_seventy():
    stack = optical_stack(LIVER, READINGS["thesis"], [500.0])
    q = element(stack, "capsule 1", "elastin").rate[0] * 10 / 0.051
    assert 65 < q < 80
    assert any("elastin: scattering efficiency up to 7" in x for x in stack.notes)
    assert not any("elastin: scattering" in x for x in optical_stack(LIVER, READINGS["consistent"], [500.0]).notes)


def test_consistent_scatters_forward_and_some_twenty_times_in_the_capsule():
    stack = optical_stack(LIVER, READINGS["consistent"], WAVELENGTH)
    assert 15 < depth(stack).min() < depth(stack).max() < 30
    collagen = element(stack, "capsule 1", "collagen")
    assert min(p.anisotropy for p in collagen.phases) > 0.9
    q = float(cylinder_mean(1.5 / 1.35, math.pi * 3500 * 1.35 / 600).q_sca)
    assert collagen.rate[5] == pytest.approx(4 * q * 0.192 / (math.pi * 3.5e-3), rel=1e-12)
    cell = element(stack, "parenchyma", "hepatocyte")
    assert cell.rate[0] == pytest.approx(53.852, abs=1e-3)
    assert cell.absorb_below_mm == 0.0
    assert {i.redirect for x in stack.layers for i in x.interactions} == {"none"}
    assert any("fibres fill 24%" in x for x in stack.notes)


def test_spheres_have_three_quarters_of_their_cross_section_over_volume():
    stack = optical_stack(LIVER, reading("consistent", fibre_density="sphere"), [600.0])
    q = float(mie(1.5 / 1.35, math.pi * 3500 * 1.35 / 600).q_sca)
    assert element(stack, "capsule 1", "collagen").rate[0] == pytest.approx(3 * q * 0.192 / (2 * 3.5e-3), rel=1e-12)
    assert element(stack, "capsule 1", "collagen").phases[0].anisotropy == pytest.approx(
        float(mie(1.5 / 1.35, math.pi * 3500 * 1.35 / 600).anisotropy), abs=1e-4
    )


def test_the_vacuum_wavenumber_is_worth_the_square_of_the_index():
    one, other = (optical_stack(LIVER, reading("thesis", mie_wavenumber=k), [600.0]) for k in ("medium", "vacuum"))
    ratio = element(other, "capsule 1", "collagen").rate / element(one, "capsule 1", "collagen").rate
    assert ratio[0] == pytest.approx(1.35**2, rel=1e-14)
    assert any("no efficiency" in x for x in other.notes)


@pytest.mark.parametrize(
    ("fit", "at_500", "at_1000"),
    [
        ("alexandrakis2005", 9.2, 9.2 * 2**-1.05),
        ("parsa1989", 9.0, 9.0 * 2**-0.617),
        ("parsa1989_rayleigh_mie", 11.5, 11.5 * (0.61 / 16 + 0.39)),
        ("yi_backman2012", 16.5, 16.5 * 2**-1.64),
        ("soft_tissue_mean", 18.9, 18.9 * 2**-1.286),
    ],
)
@pytest.mark.parametrize("g", [0.0, 0.9, 0.99])
def test_measured_has_the_published_reduced_scattering_whatever_g(fit, at_500, at_1000, g):
    changes = {"layers.parenchyma.elements.published.anisotropy": g}
    tissue = load_preset("liver", variant="parenchyma_only", changes=changes)
    stack = optical_stack(tissue, reading("measured", published_scattering=fit), [500.0, 1000.0])
    found = element(stack, "parenchyma", "published")
    reduced = found.rate * 10 * [1 - p.anisotropy for p in found.phases]
    assert reduced == pytest.approx([at_500, at_1000], rel=1e-12)
    assert found.phases[0] == HenyeyGreenstein(g)


def test_published_scattering_keeps_its_reduced_value_under_uniform_directions():
    tissue = load_preset("liver", variant="parenchyma_only")
    stack = optical_stack(tissue, reading("measured", scattering_phase="isotropic"), [500.0])
    assert element(stack, "parenchyma", "published").rate[0] == pytest.approx(0.92, rel=1e-12)


def test_cells_absorb_by_their_albedo_or_by_a_short_path():
    tissue = load_preset("liver", changes={"layers.parenchyma.elements.hepatocyte.albedo": 0.99})
    by_albedo = coefficients(tissue, reading("thesis", hepatocyte_absorption="albedo"), [500.0])
    cell = by_albedo.sel(layer="parenchyma", element="hepatocyte")
    assert float(cell.absorption[0] / cell.rate[0]) == pytest.approx(0.01, rel=1e-12)
    assert float(cell.absorb_below) == 0.0
    by_path = coefficients(tissue, READINGS["thesis"], [500.0]).sel(layer="parenchyma", element="hepatocyte")
    assert float(by_path.absorption[0]) == 0.0
    assert float(by_path.absorb_below) == pytest.approx(0.025)


def test_blood_is_eq_6_12_and_6_13_in_one_unit():
    table = datasets.load("haemoglobin_prahl")
    hbo2, hb = (float(table.interpolate(c, 540.0)) for c in ("hbo2", "hb"))
    per_cm = 0.08 * hbo2 * 0.0053558 + 0.92 * hb * 0.0053558
    shadow = 2 * 0.005 * per_cm  # R = 50 µm = 0.005 cm
    expected = 0.084 * per_cm * (1 - math.exp(-shadow)) / shadow
    found = coefficients(load_preset("liver", variant="parenchyma_only"), READINGS["consistent"], [540.0])
    assert float(found.absorption.sel(element="blood")[0, 0]) * 10 == pytest.approx(expected, rel=2e-5)


def test_zero_concentrations_are_exactly_nothing():
    zero = {f"layers.parenchyma.elements.{n}.fraction": 0.0 for n in ("blood", "lipid_and_water", "bile", "hepatocyte")}
    profile = [{"to": 1.0, "fractions": {"collagen": 0.0, "elastin": 0.0}}]
    tissue = load_preset("liver", changes=zero | {"layers.capsule.profile": profile})
    for made in (READINGS["thesis"], READINGS["consistent"]):
        stack = optical_stack(tissue, made, WAVELENGTH)
        assert all((i.rate == 0.0).all() for x in stack.layers for i in x.interactions)


def test_order_and_number_of_wavelengths_do_not_matter():
    together = coefficients(LIVER, READINGS["thesis"], [700.0, 500.0, 600.0])
    for w in (500.0, 600.0, 700.0):
        alone = coefficients(LIVER, READINGS["thesis"], w)
        assert together.sel(wavelength=[w]).drop_attrs().equals(alone.drop_attrs())


def test_coefficients_carry_units_and_leave_gaps_where_an_element_is_not():
    found = coefficients(LIVER, READINGS["thesis"], WAVELENGTH)
    assert found.absorption.attrs["units"] == found.scattering.attrs["units"] == "1/mm"
    assert found.absorption.dims == ("layer", "element", "wavelength")
    assert np.isnan(found.absorption.sel(layer="capsule 1", element="blood")).all()
    assert np.isnan(found.anisotropy.sel(layer="parenchyma", element="blood")).all()
    assert (found.anisotropy.sel(layer="parenchyma", element="hepatocyte") == 0.0).all()


def test_coefficients_can_be_written_and_read(tmp_path):
    import xarray as xr

    found = coefficients(LIVER, READINGS["thesis"], WAVELENGTH)
    found.to_netcdf(tmp_path / "c.nc", engine="h5netcdf")
    with xr.open_dataset(tmp_path / "c.nc", engine="h5netcdf") as back:
        assert found.equals(back.load())
        assert back.attrs == found.attrs


def test_the_layers_hold_what_their_elements_add_up_to():
    stack = optical_stack(LIVER, READINGS["consistent"], [500.0, 600.0])
    found = coefficients(LIVER, READINGS["consistent"], [500.0, 600.0])
    for layer in stack.layers:
        assert layer.absorption == pytest.approx(found.absorption.sel(layer=layer.name).sum("element").values)
        assert layer.scattering == pytest.approx(found.scattering.sel(layer=layer.name).sum("element").values)
        if layer.scattering[0] > 0:
            reduced = found.scattering * found.anisotropy
            mean = reduced.sel(layer=layer.name).sum("element") / layer.scattering
            assert layer.phase(1).anisotropy == pytest.approx(float(mean[1]), abs=1e-12)


@pytest.mark.parametrize(
    ("wavelength", "error", "message"),
    [
        ([440.0], RangeError, "liver_refractive_index_giannios2016"),
        ([1200.0], RangeError, "lipid_vanveen2004|haemoglobin_prahl"),
        ([-500.0], InputError, "positive"),
        ([float("nan")], InputError, "positive"),
        ([], InputError, "positive"),
        ([[500.0, 600.0]], InputError, "one dimension"),
    ],
)
def test_wavelengths_out_of_range_are_refused_by_the_source_that_ends(wavelength, error, message):
    with pytest.raises(error, match=message):
        optical_stack(LIVER, READINGS["thesis"], wavelength)


def test_a_published_fit_that_is_not_there_is_refused_with_those_that_are():
    missing = load_preset("liver", changes={"layers.parenchyma.elements.published.reference": "Parsa"})
    with pytest.raises(InputError, match="Parsa et al 1989"):
        optical_stack(missing, READINGS["measured"], [500.0])
    formless = load_preset("liver", changes={"layers.parenchyma.elements.published.form": "rayleigh_mie"})
    with pytest.raises(InputError, match="has no f_Ray"):
        optical_stack(formless, READINGS["measured"], [500.0])


def test_notes_are_said_once():
    for made in READINGS.values():
        notes = optical_stack(LIVER, made, [500.0, 600.0]).notes
        assert len(notes) == len(set(notes))


@pytest.mark.slow
def test_a_spectrum_is_quick():
    for options, few_s, many_s in (({"fibre_density": "sphere"}, 0.3, 1.5), ({}, 3.0, 40.0)):
        made = reading("consistent", **options)
        optical_stack(LIVER, made, [555.5])  # compiles
        start = time.process_time()
        optical_stack(LIVER, made, WAVELENGTH + 0.1)
        few = time.process_time() - start
        start = time.process_time()
        optical_stack(LIVER, made, np.arange(500.5, 721.0))
        many = time.process_time() - start
        assert few < few_s, (made.name, few)
        assert many < many_s, (made.name, many)
