"""What a fit says of a lobe that is narrow for the picture, or for lamps whose size nobody said."""

import pytest
from brdf_fit_rig import lights, pictures

from livlab.brdf.fit.fit import fit
from livlab.brdf.sphere import extract


def samples_of(alpha, radius_px=40.0):
    lamps = lights(6)
    return extract(*pictures("lambert+ggx", {"kd": 0.3, "ks": 0.9, "alpha": alpha}, lamps, radius_px, inside=6))


def said(samples, words):
    found = fit(samples, "lambert+ggx", warn=False, bootstrap=None)
    return [text for text in found.warnings if words in text]


@pytest.mark.parametrize(("alpha", "needed"), [(0.05, "90 px"), (0.3, None)])
def test_a_lobe_that_is_narrow_for_the_picture_is_told(alpha, needed):
    """The rule: a radius of 4.5 / alpha pixels, here 90 for .05 and 15 for .3, on a ball of 40."""
    found = said(samples_of(alpha), "px radius")
    assert (len(found) == 1 and needed in found[0]) if needed else found == []


def test_an_unknown_lamp_is_told_with_the_size_it_may_have():
    samples = samples_of(0.1)
    assert said(samples, "lamps' size") == []  # rendered lamps are points
    found = said(samples.assign_attrs(lamp_size="not given"), "lamps' size")
    assert len(found) == 1 and "below 2.3 deg" in found[0]  # 0.4 alpha
    assert said(samples_of(0.3).assign_attrs(lamp_size="not given"), "lamps' size") == []
    assert said(samples.assign_attrs(lamp_size="given"), "lamps' size") == []
