"""BRDF experiment files: what fits, what does not, and what the user is told."""

import math

import pytest

from livlab.config import builtin_experiments, load_experiment, parse_experiment, to_toml
from livlab.errors import ConfigError, InputError
from livlab.kinds.brdf.job import prepare
from livlab.runs.identity import canonical

MATERIAL = """
schema = 1
kind = "brdf"
name = "small"
[rig]
radius_px = 20.0
[rig.lights]
count = 2
[[material]]
name = "matt"
bsdf = { type = "diffuse", reflectance = [0.5, 0.4, 0.3] }
fit = { model = "lambert" }
true = { "kd[R]" = 0.5 }
"""
LIVER = """
schema = 1
kind = "brdf"
name = "liver"
readings = ["measured"]
[tissue]
preset = "liver"
[wavelengths]
list_nm = [550.0, 650.0]
[rig.lights]
distance_radii = "infinite"
[scan]
kind = "collinear"
"""


@pytest.mark.parametrize("text", [MATERIAL, LIVER])
def test_a_file_in_full_reads_as_itself(text):
    config = parse_experiment(text).resolve()
    again = parse_experiment(to_toml(config))
    assert again == config
    assert canonical(again) == canonical(config)


def test_those_that_come_with_livlab_read():
    named = [path for name, path in builtin_experiments().items() if name.startswith("brdf-")]
    assert len(named) >= 1
    for path in named:
        assert load_experiment(path).resolve().kind == "brdf"


def test_the_rig_is_as_written():
    rig = parse_experiment(MATERIAL).rig.build()
    assert len(rig.lights) == 2
    assert rig.lights[0].position_mm is not None
    far = parse_experiment(MATERIAL.replace("count = 2", 'count = 2\ndistance_radii = "infinite"')).rig.build()
    assert far.lights[0].position_mm is None
    listed = MATERIAL.replace("count = 2", 'layout = "list"\nlist_deg = [[0.0, 0.0], [30.0, 90.0], [60.0, 10.0]]')
    made = parse_experiment(listed).rig.build().lights
    assert len(made) == 3
    assert math.degrees(math.acos(made[1].position_mm[2] / 250.0)) == pytest.approx(30.0)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("count = 2", "count = 0", "count"),
        ("count = 2", "cuont = 2", "did you mean|Did you mean"),
        ("count = 2", 'layout = "list"', "list_deg"),
        ("count = 2", "distance_radii = 0.9", "must be > 1"),
        ("radius_px = 20.0", "radius_px = 1.0", "radius_px"),
        ("radius_px = 20.0", "camera_radii = 0.5", "camera_radii"),
        ('type = "diffuse", ', "", "must name a Mitsuba BSDF"),
        ('fit = { model = "lambert" }', "", "nothing is fitted"),
        ("[[material]]", '[[criterion]]\nmetric = "relative rms"\nof = "mat"\ntolerance = 1.0\n[[material]]', "matt"),
        ("[[material]]", '[[criterion]]\nmetric = "parameter error"\ntolerance = 1.0\n[[material]]', "parameter"),
        ("[[material]]", '[tissue]\npreset = "liver"\n[[material]]', "not both"),
    ],
)
def test_what_does_not_fit_is_named(old, new, said):
    with pytest.raises(ConfigError, match=said):
        parse_experiment(MATERIAL.replace(old, new, 1))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('readings = ["measured"]', "", "readings"),
        ("list_nm = [550.0, 650.0]", "", "wavelengths"),
        ('distance_radii = "infinite"', "distance_radii = 10.0", "distant"),
        ("[scan]", "[goniometer]\ntheta_step_deg = 10.0\n[scan]", "multiple of goniometer.theta_step_deg"),
        (
            "[scan]",
            '[[criterion]]\nmetric = "rmse"\nagainst = "goniometer"\nwavelength_nm = 600.0\ntolerance = 1.0\n[scan]',
            "is not looked at",
        ),
        ('kind = "collinear"', 'kind = "incidence"\nincidence_deg = 90.0', "incidence_deg"),
        ("[scan]", "[goniometer]\ntheta_step_deg = 7.0\n[scan]", "must divide 90"),
    ],
)
def test_what_does_not_fit_of_a_liver_is_named(old, new, said):
    with pytest.raises(ConfigError, match=said):
        parse_experiment(LIVER.replace(old, new, 1))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("diffuse", "difuse", "not taken by Mitsuba"),
        ('"diffuse", reflectance = [0.5, 0.4, 0.3]', '"dielectric"', "lets light through"),
        ('model = "lambert"', 'model = "lamberd"', "is no lobe"),
        ('model = "lambert"', 'model = "lambert", fixed = { ks = 1.0 }', "has no such parameter"),
        ('"kd[R]" = 0.5', "alpha = 0.5", "has no such parameter"),
    ],
)
def test_what_only_the_engines_know_is_refused_before_the_work(old, new, said):
    config = parse_experiment(MATERIAL.replace(old, new, 1)).resolve()
    with pytest.raises(InputError, match=said):
        prepare(config)
