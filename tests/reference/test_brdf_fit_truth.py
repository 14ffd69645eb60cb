"""Spheres that the renderer pictured, read with the pose known, give their material's parameters back."""

import numpy as np
import pytest

from livlab.acquire.instruments.sphere_rig import SphereRig, arc, light, photograph
from livlab.brdf.fit.fit import fit
from livlab.brdf.sphere import extract
from livlab.errors import EnvironmentProblem

pytestmark = pytest.mark.filterwarnings("ignore::livlab.optimise.FitWarning")


def mirror(alpha):
    return {"type": "roughconductor", "distribution": "ggx", "alpha": alpha, "material": "none"}


def plastic(alpha):
    return {
        "type": "roughplastic", "distribution": "ggx", "alpha": alpha, "int_ior": 1.5, "ext_ior": 1.0,
        "diffuse_reflectance": [0.5, 0.3, 0.1],
    }  # fmt: skip


def samples_of(material, radius_px, lights, camera_radii=10.0):
    rig = SphereRig.make(lights, radius_px=radius_px, camera_radii=camera_radii, silhouette="none")
    try:
        taken = photograph(rig, material)
    except EnvironmentProblem as error:
        pytest.skip(str(error))
    return extract(taken.images, taken.camera, taken.lights, taken.sphere)


@pytest.mark.parametrize(
    ("material", "name", "truth"),
    [
        (mirror(0.1), "ggx-mirror", {"ks[G]": 1.0, "alpha": 0.1}),
        (mirror(0.6), "ggx-mirror", {"ks[G]": 1.0, "alpha": 0.6}),
        (plastic(0.1), "plastic", {"kd[R]": 0.5, "kd[B]": 0.1, "ks[G]": 1.0, "alpha": 0.1}),
        (
            {"type": "principled", "base_color": [0.5, 0.3, 0.1], "roughness": 0.4, "eta": 1.5},
            "principled",
            {"kd[R]": 0.5, "kd[B]": 0.1, "ks[G]": 1.0, "alpha": 0.16},
        ),
        ({"type": "diffuse", "reflectance": [0.5, 0.3, 0.1]}, "lambert", {"kd[R]": 0.5, "kd[G]": 0.3, "kd[B]": 0.1}),
    ],
)
def test_known_pose_within_two_thousandths(material, name, truth):
    found = fit(samples_of(material, 58.0, arc(6, first_deg=10, last_deg=120)), name)
    got = {k: found.values[k] for k in truth}
    assert got == pytest.approx(truth, rel=2e-3)


def test_near_camera_and_light_and_a_narrow_lobe():
    """Camera at 5 radii, lights at 6, roughness of 1.7 pixels: the pixel's footprint decides."""
    lamps = [light(a, 40.0 * k, distance_radii=6.0) for k, a in enumerate((15.0, 35.0, 60.0, 85.0))]
    samples = samples_of(mirror(0.03), 58.0, lamps, camera_radii=5.0)
    found = fit(samples, "ggx-mirror", start={"alpha": 0.3})
    assert found.values["alpha"] == pytest.approx(0.03, rel=5e-3)
    assert found.values["ks[G]"] == pytest.approx(1.0, rel=5e-3)
    centres = fit(samples, "ggx-mirror", footprint=None)
    assert abs(centres.values["alpha"] / 0.03 - 1) > 4 * abs(found.values["alpha"] / 0.03 - 1)


@pytest.mark.slow
def test_the_stated_bar_at_full_size():
    """12 lights, radius 115 px: roughness and scale within 0.2 %."""
    for alpha in (0.03, 0.1, 0.3):
        found = fit(samples_of(mirror(alpha), 115.0, arc(12)), "ggx-mirror")
        assert found.values["alpha"] == pytest.approx(alpha, rel=2e-3)
        assert found.values["ks[G]"] == pytest.approx(1.0, rel=2e-3)
        assert np.isfinite(found.bic)
