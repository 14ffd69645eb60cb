"""What leaves an effect out of a stack: merged sublayers, widened phase functions, similarity, a matched interface."""

import math
from dataclasses import replace

import numpy as np
import pytest

from livlab.effects import reduce
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic, Rayleigh, Tabulated
from livlab.model.tissue.stack import Interaction, PlaneLayer, plain_stack


def layer(name, thickness, n, parts):
    one = np.ones(2)
    return PlaneLayer(
        name, thickness, n * one, tuple(Interaction(k, r * one, a * one, (p,) * 2) for k, r, a, p in parts)
    )


def two_sublayers(n=(1.35, 1.35)):
    hg, iso = HenyeyGreenstein(0.9), Isotropic()
    layers = (
        layer("skin 1", 0.1, n[0], [("fibre", 10.0, 1.0, hg), ("dye", 1.0, 0.0, iso)]),
        layer("skin 2", 0.3, n[1], [("fibre", 2.0, 0.5, iso)]),
        layer("fat", math.inf, 1.45, [("fibre", 5.0, 1.0, hg), ("dye", 0.2, 0.0, iso)]),
    )
    stack = plain_stack([(1.0, 1.0, 0.0, 1.0, iso)])
    return replace(stack, wavelength_nm=np.array([500.0, 600.0]), layers=layers, n_above=np.ones(2), n_below=np.ones(2))


def test_merged_sublayers_keep_optical_depth_absorption_and_phase():
    stack = two_sublayers()
    names = frozenset({"skin 1", "skin 2"})
    one = reduce.merged(stack, names, "skin").layers[0]
    parts = stack.layers[:2]
    assert one.name == "skin" and one.thickness_mm == pytest.approx(0.4)
    for what in ("absorption", "scattering"):
        depth = sum(getattr(x, what) * x.thickness_mm for x in parts)
        assert np.allclose(getattr(one, what) * one.thickness_mm, depth)
    depths = [x.scattering[0] * x.thickness_mm for x in parts]
    g = sum(d * x.phase(0).anisotropy for d, x in zip(depths, parts, strict=True)) / sum(depths)
    assert one.phase(0).anisotropy == pytest.approx(g)
    # Another index in one of them, or a gap between them: nothing to merge.
    assert len(reduce.merged(two_sublayers((1.35, 1.36)), names, "skin").layers) == 3
    assert len(reduce.merged(stack, frozenset({"skin 1", "fat"}), "x").layers) == 3


@pytest.mark.parametrize("angle", [5.0, 30.0, 60.0, 90.0, 150.0, 179.0])
@pytest.mark.parametrize("phase", [HenyeyGreenstein(0.95), HenyeyGreenstein(0.3), Rayleigh(), Isotropic()])
def test_widened_phase_keeps_how_much_light_is_turned_and_the_wide_angles(phase, angle):
    wide, share = reduce.widened_phase(phase, angle)
    assert 0.0 < share <= 1.0
    assert share * (1.0 - wide.anisotropy) == pytest.approx(1.0 - phase.anisotropy, rel=1e-9)
    cosines = np.cos(np.radians(np.linspace(angle + 0.5, 180.0, 40)))
    # Between its points the table is a chord of p: good to a part in 1000.
    assert np.allclose(share * wide.pdf(cosines), phase.pdf(cosines), rtol=1e-3)
    inside = np.cos(np.radians(np.linspace(0.0, angle, 40)))
    assert (wide.pdf(inside) >= 0.0).all()
    assert 2 * math.pi * np.trapezoid(wide.pdf(x := np.linspace(-1, 1, 200_001)), x) == pytest.approx(1.0, abs=1e-4)


def test_widening_a_forward_peak_saves_most_of_the_scattering():
    shares = [reduce.widened_phase(HenyeyGreenstein(0.95), a)[1] for a in (30.0, 60.0, 90.0)]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] < 0.35 and shares[2] < 0.12


def test_widening_gives_up_where_no_line_fits():
    # All small-angle scattering in a ring just inside the cone: the line through its edge would fall below 0.
    ring = Tabulated.from_complement([0.0, 0.4, 0.5, 0.6, 2.0], [0.0, 0.0, 1.0, 0.0, 0.0])
    wide, share = reduce.widened_phase(ring, math.degrees(math.acos(0.5)))
    assert wide is ring and share == 1.0


def test_similarity_keeps_reduced_scattering_and_absorption():
    alike = reduce.similar(two_sublayers(), frozenset({"skin 2", "fat"}))
    full = two_sublayers()
    assert alike.layers[0] is full.layers[0] or np.array_equal(alike.layers[0].scattering, full.layers[0].scattering)
    assert np.allclose(alike.layers[2].scattering, 0.1 * full.layers[2].scattering)
    assert np.allclose(alike.layers[2].absorption, full.layers[2].absorption)
    assert alike.layers[2].phase(0) == Isotropic()
    # What goes with every scattering is no matter of angles: left as it is.
    steered = replace(full.layers[2].interactions[0], redirect="abs_cos")
    stack = replace(full, layers=(replace(full.layers[2], interactions=(steered,)),))
    assert np.array_equal(reduce.similar(stack, frozenset({"fat"})).layers[0].scattering, stack.layers[0].scattering)


def test_matched_interface_gives_the_thinner_side_the_other_index():
    stack = reduce.matched_interface(two_sublayers(), frozenset({"skin 2"}), frozenset({"fat"}))
    assert [float(x.n[0]) for x in stack.layers] == [1.45, 1.45, 1.45]
    thick = replace(two_sublayers().layers[0], thickness_mm=50.0)
    thin = replace(two_sublayers().layers[2], thickness_mm=0.1)
    turned = reduce.matched_interface(
        replace(two_sublayers(), layers=(thick, thin)), frozenset({"skin 1"}), frozenset({"fat"})
    )
    assert [float(x.n[0]) for x in turned.layers] == [1.35, 1.35]
