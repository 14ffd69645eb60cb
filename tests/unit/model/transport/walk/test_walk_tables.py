"""A stack laid out for the kernel: what is merged, what stays apart."""

import math

import numpy as np
import pytest

from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic, Rayleigh
from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer, plain_stack
from livlab.model.transport.walk.tables import HENYEY_GREENSTEIN, ISOTROPIC, RAYLEIGH, TABULATED, _Store, tables

ONE = np.ones(2)
ISO, HG, RAY = (Isotropic(),) * 2, (HenyeyGreenstein(0.9),) * 2, (Rayleigh(),) * 2


def stack(*parts, thickness=1.0):
    layer = PlaneLayer("only", thickness, 1.4 * ONE, parts)
    return OpticalStack(np.array([500.0, 600.0]), (layer,), ONE, 1.5 * ONE)


def test_expected_sums_rates_and_merges_what_scatters_alike():
    t = tables(
        stack(
            Interaction("a", 1.0 * ONE, 0 * ONE, ISO),
            Interaction("b", np.array([2.0, 0.0]), ONE, HG),
            Interaction("c", 1.0 * ONE, 0.5 * ONE, RAY),
            Interaction("d", 2.0 * ONE, ONE, (HenyeyGreenstein(0.9), HenyeyGreenstein(0.9))),
        ),
        "expected",
    )
    assert t.shape.ways == 2
    assert t.mfp[0, 0] == pytest.approx([1 / 6, 1 / 4])
    assert t.survive[0] == pytest.approx(np.array([[4 / 6, 2 / 4], [0.5 / 6, 0.5 / 4]]))
    assert t.kind[0].tolist() == [[HENYEY_GREENSTEIN] * 2, [RAYLEIGH] * 2]
    assert t.shape.kinds == (RAYLEIGH, HENYEY_GREENSTEIN)


def test_factors_and_short_paths_keep_ways_apart():
    t = tables(
        stack(
            Interaction("b", ONE, ONE, ISO, redirect="abs_cos"),
            Interaction("c", ONE, ONE, ISO, absorb_below_mm=0.1),
            Interaction("d", ONE, ONE, ISO, redirect="abs_cos"),
        ),
        "expected",
    )
    assert t.shape.ways == 2
    assert t.survive[0, :, 0] == pytest.approx([2 / 3, 1 / 3])
    assert t.below[0].tolist() == [0.0, 0.1]
    assert t.shape.redirects == (0, 1)
    assert t.shape.short
    assert not t.shape.steered


def test_analog_keeps_every_element_and_drops_those_that_never_act():
    t = tables(
        stack(Interaction("a", ONE, 0 * ONE, HG), Interaction("n", 0 * ONE, ONE, HG), Interaction("b", ONE, ONE, ISO)),
        "analog",
    )
    assert t.shape.ways == 2
    assert t.survive[0, :, 0].tolist() == [0.0, 1.0]
    assert t.shape.kinds == (ISOTROPIC,)


def test_a_clear_layer_never_interacts():
    t = tables(stack(), "expected")
    assert np.isinf(t.mfp).all()
    assert t.shape.kinds == (ISOTROPIC,)


def test_an_endless_layer_has_no_lower_interface():
    t = tables(stack(thickness=math.inf), "expected")
    assert t.index[-1].tolist() == [1.4, 1.4]
    assert tables(stack(), "expected").index[-1].tolist() == [1.5, 1.5]


def test_closed_forms_need_no_table_and_equal_phases_share_one():
    store = _Store()
    assert store.add(Isotropic()) == store.add(HenyeyGreenstein(0.0)) == (ISOTROPIC, 0.0, 0)
    assert store.add(HenyeyGreenstein(0.7)) == (HENYEY_GREENSTEIN, 0.7, 0)
    from livlab.model.tissue.phase.functions import mixture

    first = store.add(mixture([HenyeyGreenstein(0.7), Rayleigh()], [1.0, 1.0]))
    again = store.add(mixture([HenyeyGreenstein(0.7), Rayleigh()], [1.0, 1.0]))
    other = store.add(mixture([HenyeyGreenstein(0.7), Rayleigh()], [1.0, 2.0]))
    assert first == again == (TABULATED, 0.0, 0)
    assert other[2] == store.table().size // 2


def test_fresnel_is_left_out_where_no_index_changes():
    phase = HenyeyGreenstein(0.5)
    assert not tables(plain_stack([(1.0, 1.0, 1.0, 1.0, phase)]), "expected").shape.fresnel
    assert tables(plain_stack([(1.0 + 1e-7, 1.0, 1.0, 1.0, phase)]), "expected").shape.fresnel
