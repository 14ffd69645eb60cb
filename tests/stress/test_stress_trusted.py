"""The trusted values of the catalogue are computed anew and are those that are stored."""

import math

import pytest
from trusted_values import table as references
from trusted_values.forms import fresnel, plates
from trusted_values.scatterers import cylinder, sphere
from trusted_values.transport import half_space, thick_slab

from livlab.stress.catalogue import cases, trusted_values

pytest.importorskip("mpmath")

COMPUTED = [c for c in cases() if any(e.reference for e in c.expect)]
LONG = {
    *("mie/transparent", "mie/huge", "mie/nearly matched", "mie/metal", "mie/soot", "mie/bubble", "mie/void"),
    *("mie/matching hand-over", "mie/matching hand-over, beyond", "cylinder/sizes", "cylinder/metal"),
    *("cylinder/mean of a thread", "fresnel/diffuse light", "adding-doubling/albedo", "walk/peak of g = 0.9999"),
    *("cylinder/grazing", "cylinder/grazing and absorbing", "cylinder/nearly matched", "adding-doubling/thin on thick"),
    *("energy/thesis, what Algorithm 2 takes", "solvers/dipole"),
    *(f"walk/{x}" for x in ("albedo 1e-9", "half-space of albedo 1 - 1e-6", "optical depth 1e6")),
    "energy/thesis with an albedo, what Algorithm 2 takes",
}
"""A few seconds each."""


@pytest.mark.parametrize(
    "case",
    [pytest.param(c, id=c.name, marks=[pytest.mark.slow] if c.slow or c.name in LONG else []) for c in COMPUTED],
)
def test_stored_values_are_computed_ones(case):
    rows = references.compute(case)
    assert rows
    for name, quantity, index, text, by in rows:
        stored, said = trusted_values()[name, quantity]
        # Adding–doubling sums in an order that the linear algebra library chooses.
        loose = "adding" in by
        want = float(text)
        assert said == by
        assert stored[index] == pytest.approx(want, rel=1e-7 if loose else 4e-16, abs=1e-10 if loose else 0.0)


def test_nothing_is_stored_that_no_case_asks_for():
    wanted = {(c.name, e.quantity) for c in COMPUTED for e in c.expect if e.reference}
    assert set(trusted_values()) == wanted


def near(found, want, digits):
    """Whether many digits agree with published ones."""
    return float(found) == pytest.approx(want, abs=0.5 * 10.0**-digits)


def test_references_against_published_values():
    """Wiscombe 1979 and van de Hulst 1957, 1980; H functions of Chandrasekhar 1950."""
    soot = sphere([1.5, 1.0], [1.0, 100.0])
    assert near(soot["q_ext"][0], 2.336321, 6)
    assert near(soot["q_sca"][1], 1.283697, 6)
    assert near(soot["anisotropy"][1], 0.850252, 6)
    water = sphere([0.75, 0.0], [0.099, 10.0])
    assert near(water["q_sca"][0] * 1e6, 7.417859, 6)
    assert near(water["anisotropy"][1], 0.896473, 6)
    rod = cylinder([1.55, 0.0], 5.213, math.pi / 2)
    assert near(rod["q_sca"][0], 2.0124, 4)  # Bohren & Huffman 1983, p. 496: 2.0972 and 1.9277 (case I, II)
    assert near(fresnel(1.0, 1.5, 1.0)["reflectance"][0], 0.04, 12)
    assert near(plates([1.0, 1.5, 1.0])["reflectance"][0], 1 / 13, 12)
    space = half_space([0.8, 0.001], [0.2, 0.999])
    assert near(space["reflectance"][0], 0.0352305, 7)
    assert near(space["reflectance"][1], 0.9128453, 7)
    # Hopf's constant 2q = 1.4208922 and H(1) = 2.9078105 (Chandrasekhar 1950; van de Hulst 1980).
    escape = math.sqrt(3) / 4 * 2.9078105
    assert near(4 * escape / 3 / thick_slab(1.0, 0.0)["transmittance"][0], 1.4208922, 6)
