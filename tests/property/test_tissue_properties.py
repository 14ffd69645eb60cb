"""Whatever the numbers: never nan, monotone in the fractions, additive, and equal after a round trip."""

import tomllib

import numpy as np
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from livlab.model.tissue.chromophores import packaging
from livlab.model.tissue.optics import coefficients, optical_stack
from livlab.model.tissue.particles.spheroid import attenuation, penalised_rate, surface_term
from livlab.model.tissue.presets import TissueSpec, load_preset
from livlab.model.tissue.readings import Reading, reading

LIVER = load_preset("liver")
share = st.floats(0.0, 1.0)
length = st.floats(1e-6, 1e6)
wavelengths = st.lists(st.floats(450.0, 1000.0), min_size=1, max_size=3)
options = st.fixed_dictionaries(
    {},
    optional={
        "elastin_index": st.sampled_from(["absolute", "relative"]),
        "small_fibre_law": st.sampled_from(["rayleigh", "mie"]),
        "mie_wavenumber": st.sampled_from(["medium", "vacuum"]),
        "hepatocyte_axes": st.sampled_from(["diameters", "semi_axes"]),
        "hepatocyte_rate": st.sampled_from(["log10", "linear"]),
        "hepatocyte_absorption": st.sampled_from(["free_path", "albedo"]),
        "redirect_factor": st.sampled_from(["abs_cos", "cos", "clamped_cos", "none"]),
        "lipid_bile": st.sampled_from(["table", "prose"]),
        "blood_fraction": st.sampled_from([0.084, 0.034]),
        "parenchyma_scattering": st.sampled_from(["hepatocyte", "published"]),
    },
)
readings = st.builds(
    lambda base, density, chosen: reading(base, fibre_density=density, scattering_phase="isotropic", **chosen),
    st.sampled_from(["thesis", "consistent"]),
    st.sampled_from(["areal", "sphere"]),
    options,
)


@st.composite
def tissues(draw):
    blood = draw(st.floats(0.0, 0.5))
    mixture = draw(st.floats(0.0, 0.45))
    elastin = draw(st.floats(0.0, 0.5))
    base = "layers.parenchyma.elements"
    return load_preset(
        "liver",
        state=draw(st.sampled_from(["ex_vivo", "in_vivo", "steatosis"])),
        changes={
            f"{base}.blood.fraction": blood,
            f"{base}.blood.oxygenation": draw(share),
            f"{base}.blood.vessel_radius_um": draw(st.floats(0.0, 1e4)),
            f"{base}.lipid_and_water.fraction": mixture,
            f"{base}.lipid_and_water.parts.lipid.share": draw(share),
            f"{base}.hepatocyte.fraction": draw(share),
            f"{base}.hepatocyte.a_um": draw(st.floats(0.1, 1e3)),
            f"{base}.hepatocyte.b_um": draw(st.floats(0.1, 1e3)),
            "layers.capsule.profile.0.fractions.elastin": elastin,
            "layers.capsule.profile.0.fractions.collagen": draw(st.floats(0.0, 0.5)),
        },
    )


@settings(max_examples=40, deadline=None)
@given(tissues(), readings, wavelengths)
def test_no_stack_has_a_nan_and_layers_are_the_sum_of_their_elements(tissue, made, wavelength):
    stack = optical_stack(tissue, made, wavelength)
    found = coefficients(tissue, made, wavelength)
    for layer in stack.layers:
        for i in layer.interactions:
            assert np.isfinite(i.rate).all()
            assert (i.rate >= 0).all()
        total = found.rate.sel(layer=layer.name).sum("element").values
        assert np.allclose(total, layer.absorption + layer.scattering, rtol=1e-12, atol=0)
    one = found.absorption.fillna(0.0) + found.scattering.fillna(0.0)
    assert np.allclose(one, found.rate.fillna(0.0), rtol=1e-14, atol=0)


@settings(max_examples=30, deadline=None)
@given(st.floats(0.0, 0.09), st.floats(0.0, 0.09), share, st.floats(0.0, 1e3), wavelengths)
def test_blood_absorbs_in_proportion_to_its_fraction(one, other, oxygenation, radius, wavelength):
    base = "layers.parenchyma.elements.blood"
    plain = {f"{base}.oxygenation": oxygenation, f"{base}.vessel_radius_um": radius}

    def absorbed(fraction):
        tissue = load_preset("liver", variant="parenchyma_only", changes=plain | {f"{base}.fraction": fraction})
        return coefficients(tissue, reading("consistent"), wavelength).absorption.sel(element="blood").values

    assert np.allclose(absorbed(one) * other, absorbed(other) * one, rtol=1e-12, atol=1e-300)
    if one <= other:
        assert (absorbed(one) <= absorbed(other)).all()


@given(length, length, share, share)
def test_more_cells_attenuate_more_and_the_penalty_turns_it_round(a, b, one, other):
    low, high = sorted((attenuation(a, b, one), attenuation(a, b, other)))
    assert low == attenuation(a, b, min(one, other))
    rate = penalised_rate(np.array([low, high]))
    assert np.isfinite(rate).all()
    if low > 1e-12:
        assert rate[0] >= rate[1]


@given(length, length)
def test_a_body_never_has_less_surface_than_the_sphere_of_its_volume(a, b):
    surface_over_volume = 1.5 / a * surface_term(a, b)
    sphere = 3.0 / (a * a * b) ** (1 / 3)
    assert surface_over_volume >= sphere * (1 - 1e-12)


@given(st.floats(0.0, 1e3), st.floats(0.0, 1e6), st.floats(0.0, 1e6))
def test_packaging_lies_in_0_1_and_falls_while_what_is_absorbed_rises(radius, one, other):
    sigma = np.array(sorted((one, other)))
    c = packaging(radius, sigma)
    assert ((c >= 0) & (c <= 1)).all()
    assert c[1] <= c[0] * (1 + 1e-15)
    assert sigma[1] * c[1] >= sigma[0] * c[0] * (1 - 1e-14)


@settings(max_examples=20, deadline=None)
@given(tissues(), readings)
def test_a_tissue_and_a_reading_read_back_equal(tissue, made):
    text = tomli_w.dumps(TissueSpec(inline=tissue).model_dump(mode="json", exclude_none=True))
    assert TissueSpec.model_validate(tomllib.loads(text)).build() == tissue
    assert Reading.model_validate(tomllib.loads(tomli_w.dumps(made.model_dump(mode="json")))) == made
