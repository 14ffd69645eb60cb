"""The virtual rig: its geometry, its outline frames, and what it refuses."""

import math
from dataclasses import replace

import numpy as np
import pytest

from livlab.acquire.instruments.sphere_rig import SphereRig, arc, light, outline, photograph, ring
from livlab.brdf.geometry import Light
from livlab.errors import InputError
from livlab.model.tracer.materials import evaluate, material_dict

DIFFUSE = {"type": "diffuse", "reflectance": [0.5, 0.4, 0.3]}


def small(**options):
    return SphereRig.make(arc(1, first_deg=20.0), radius_px=12, silhouette="none", **options)


def test_the_thesis_took_eight_pictures():
    rig = SphereRig.make()
    assert len(rig.lights) == 8
    assert rig.camera.width == rig.camera.height


def test_lights_give_unit_irradiance_at_the_centre_and_stand_where_they_are_asked():
    for made in (*arc(4), *ring(3), *arc(2, distance_radii=math.inf)):
        place = made.direction if made.position_mm is None else made.position_mm
        distance = 1.0 if made.position_mm is None else np.linalg.norm(place)
        assert made.intensity / distance**2 == pytest.approx(np.ones(3))
    angles = [math.degrees(math.acos(x.position_mm[2] / np.linalg.norm(x.position_mm))) for x in arc(3)]
    assert angles == pytest.approx([10.0, 70.0, 130.0])
    assert np.std([x.position_mm[2] for x in ring(5)]) < 1e-9


@pytest.mark.parametrize("kind", ["back-lit", "all-round"])
def test_the_outline_covers_what_the_sphere_covers(kind):
    rig = replace(small(), silhouette=kind)
    frame = outline(rig).to_numpy()
    covered = (1 - frame if kind == "back-lit" else frame).sum()
    assert covered == pytest.approx(math.pi * 12**2, rel=1e-3)
    assert frame.min() >= 0
    assert frame.max() == pytest.approx(1.0, abs=1e-4)


def test_pictures_repeat_and_seeds_differ():
    first, again, other = (photograph(small(), DIFFUSE, seed=s).images for s in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert first.dims == ("light", "row", "column", "channel")


def test_colours_pass_through():
    image = photograph(small(), DIFFUSE).images
    total = image.sum(("light", "row", "column")).to_numpy()
    assert total / total[0] == pytest.approx([1.0, 0.8, 0.6], rel=1e-4)


def test_many_samples_are_averaged_in_passes():
    few, many = (photograph(small(samples_per_pixel=n), DIFFUSE, seed=1).images for n in (1024, 2048))
    assert float(np.abs(few - many).max()) < 0.01 * float(few.max())
    assert not np.array_equal(few, many)


def test_mitsubas_value_becomes_livlabs():
    n = np.array([[math.sin(0.5), 0.0, math.cos(0.5)]])
    assert evaluate(DIFFUSE, n, n)[0] == pytest.approx(np.array([0.5, 0.4, 0.3]) / math.pi, rel=1e-5)
    rough = {"type": "roughconductor", "alpha": 0.2, "distribution": "ggx", "material": "Au"}
    other = np.array([[-math.sin(1.1), 0.0, math.cos(1.1)]])
    # Reciprocal: had the cosine stayed in, the two would differ by cos 0.5 / cos 1.1.
    assert evaluate(rough, n, other)[0] == pytest.approx(evaluate(rough, other, n)[0], rel=1e-4)
    assert (evaluate(DIFFUSE, -n, n) == 0).all()


def test_tables_become_what_mitsuba_takes():
    nested = material_dict({"type": "blendbsdf", "weight": 0.5, "a": {"type": "diffuse", "reflectance": [1, 0, 0]}})
    assert nested["a"]["reflectance"] == {"type": "rgb", "value": [1.0, 0.0, 0.0]}
    spectrum = material_dict({"type": "diffuse", "reflectance": [[400, 0.1], [700, 0.9]]})
    assert spectrum["reflectance"] == {"type": "spectrum", "value": [(400.0, 0.1), (700.0, 0.9)]}


@pytest.mark.parametrize(
    ("material", "said"),
    [
        ({"reflectance": 0.5}, "must name a Mitsuba BSDF"),
        ({"type": "difuse"}, "is not taken by Mitsuba"),
        ({"type": "diffuse", "reflectanse": 0.5}, "is not taken by Mitsuba"),
        ({"type": "point"}, "is no BSDF"),
        ({"type": "dielectric"}, "lets light through"),
        ({"type": "roughdielectric", "alpha": 0.1}, "lets light through"),
        ({"type": "conductor"}, "perfect mirror"),
        ({"type": "diffuse", "reflectance": float("nan")}, "must be finite"),
        ({"type": "diffuse", "reflectance": [0.1, 0.2]}, "must be a number"),
    ],
)
def test_materials_that_cannot_be_measured_are_refused(material, said):
    with pytest.raises(InputError, match=said):
        photograph(small(), material)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"radius_px": 1.0}, "radius_px"),
        ({"radius_px": math.nan}, "radius_px"),
        ({"camera_radii": 1.0}, "camera_radii"),
        ({"radius_mm": 0.0}, "radius_mm"),
        ({"radius_px": 5000.0}, "pixels"),
        ({"lights": []}, "at least one light"),
    ],
)
def test_rigs_that_cannot_be_are_refused(options, said):
    with pytest.raises(InputError, match=said):
        SphereRig.make(**options)


def test_what_the_renderer_has_not_is_refused():
    rig = small()
    with pytest.raises(InputError, match="is not rendered"):
        replace(rig, camera=replace(rig.camera, distortion=np.array([0.1, 0, 0, 0, 0])))
    stretched = rig.camera.matrix.copy()
    stretched[0, 0] *= 1.1
    with pytest.raises(InputError, match="square pixels"):
        photograph(replace(rig, camera=replace(rig.camera, matrix=stretched)), DIFFUSE)
    inside = Light(np.ones(3), position_mm=np.array([1.0, 0.0, 0.0]))
    with pytest.raises(InputError, match="within the sphere"):
        photograph(replace(rig, lights=(inside,)), DIFFUSE)
    with pytest.raises(InputError, match="distance_radii"):
        light(10.0, distance_radii=0.5)
    with pytest.raises(InputError, match="samples_per_pixel"):
        photograph(replace(rig, samples_per_pixel=0), DIFFUSE)
