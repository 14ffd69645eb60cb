"""The table of lights: what it holds, what it tells, that acting on what it tells spoils no light, and the command."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from light_rigs import GLOSSY, LIARS, NEAR, SPHERE, TWO, Case, photographed, placed_by, swapped
from PIL import Image
from synthetic_camera import ring
from test_photographs_check import CAMERA, LIGHTS, UP, write
from typer.testing import CliRunner

from livlab.acquire.photographs.extract import extract_samples
from livlab.acquire.photographs.hypotheses import cycles, order_in_words, threshold
from livlab.acquire.photographs.light_table import light_table
from livlab.acquire.photographs.open import open_rig
from livlab.brdf.geometry import Sphere
from livlab.cli.app import app
from livlab.errors import ConfigError, InputError


def test_the_table_holds_places_strengths_and_verdicts():
    found = light_table(photographed(Case(TWO, TWO, (GLOSSY,), strength={4: 1.2}), 0))
    table = found.table.set_index("light")
    assert len(table) == 12
    np.testing.assert_allclose(table["from_camera_deg"], [35] * 6 + [70] * 6, atol=1e-6)
    assert table["sd_deg"].isna().all()  # not said
    assert table["gain"][4] == pytest.approx(1.2, abs=0.02)
    assert np.all(np.abs(table["gain"].drop(4) - 1) < 0.03)
    assert table["verdict"][4].startswith("+") and table["verdict"].drop(4).eq("agrees").all()
    seen = table["highlight_deg"].dropna()
    assert len(seen) and np.all(table["apart_deg"].dropna() < 3)
    assert np.all(table["shading_deg"] < 1) and np.all(table["residual"] < 0.2) and np.all(table["clipped"] == 0)
    assert found.check.residual / found.check.noise < 6
    assert "agrees" in repr(found) and "x the noise" in repr(found)


@pytest.mark.parametrize("name", [name for name in LIARS if "exchanged" in name or "shifted" in name])
def test_acting_on_what_is_told_spoils_no_light(name):
    """The lights that are named are put where the diagnosis says: then each is where it truly was."""
    case = LIARS[name]
    best = light_table(photographed(case, 0)).check.best
    truth = [light.at(SPHERE.centre_mm)[0] for light in case.true]
    for light, there in zip(best.lights, truth, strict=True):
        assert light.direction @ there == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("pair", [(0, 1), (3, 9), (5, 11)])
def test_a_flip_is_not_told_where_two_are_exchanged(pair):
    lights = ring(12, 22)
    found = light_table(photographed(Case(lights, swapped(lights, pair)), 1))
    assert found.check.best.order[pair[0]] == pair[1]
    assert found.warnings[0].startswith("2 of 12")
    others = found.table[~found.table["light"].isin(pair)]
    assert others["verdict"].eq("agrees").all()


def test_two_faults_that_no_slip_explains_are_named_each():
    wrong = list(TWO)
    wrong[2] = replace(TWO[2], direction=np.array([0.0, -0.6, -0.8]))
    wrong[9] = replace(TWO[9], direction=np.array([0.6, 0.0, -0.8]))
    found = light_table(photographed(Case(TWO, wrong), 0))
    assert found.check.best is None
    assert "check the entries of light 2 and 9" in found.warnings[0]


def test_a_radius_that_does_no_harm_is_not_told_and_does_none():
    """Under distant lights a radius 22 for 20 mm makes all larger alike: every normal stays."""
    rig = photographed(Case(TWO, TWO), 0)
    larger = replace(rig, sphere=Sphere(SPHERE.centre_mm * 1.1, SPHERE.radius_mm * 1.1))
    assert light_table(larger).warnings == ()
    one, other = (extract_samples(x).samples for x in (rig, larger))
    np.testing.assert_allclose(other["value"].values, one["value"].values, rtol=1e-9)


def test_strengths_that_all_differ_are_told():
    found = light_table(photographed(Case(TWO, TWO, strength_sd=0.15), 2))
    assert "strong as declared" in found.warnings[0]


@pytest.mark.parametrize("by", [0.8, 1.25])
def test_a_focal_length_that_is_off_does_little_harm(by):
    rig = photographed(Case(TWO, TWO), 0)
    matrix = rig.camera.matrix.copy()
    matrix[[0, 1], [0, 1]] *= by
    other = replace(rig, camera=replace(rig.camera, matrix=matrix), sphere=Sphere(SPHERE.centre_mm * [1, 1, by], 20.0))
    one, moved = (extract_samples(x).samples for x in (rig, other))
    both = [x["value"].values[:, 0] for x in (one, moved)]
    mean = [float(np.average(v, weights=np.cos(x["theta_i"].values))) for v, x in zip(both, (one, moved), strict=True)]
    assert mean[1] / mean[0] == pytest.approx(1, abs=0.02) or light_table(other).warnings


def test_near_lights_in_centimetres_are_told():
    shrunk = [replace(light, position_mm=light.position_mm / 10) for light in NEAR]
    told = light_table(photographed(Case(NEAR, shrunk), 0)).warnings
    assert told and ("positions" in told[0] or "elsewhere" in told[0])


def test_one_picture_alone_can_tell():
    lamp = ring(1, 40)
    assert light_table(photographed(Case(lamp, placed_by(lamp, np.diag([-1, 1, 1]))), 0)).warnings


def test_permutations_in_words():
    assert cycles([1, 0, 2, 4, 3]) == [[0, 1], [3, 4]]
    assert order_in_words([0, 2, 1], [0, 1, 2]).startswith("lights 1 and 2 exchanged")
    assert "shifted by 1" in order_in_words([1, 2, 3, 0], [0, 1, 2, 3])
    assert "reversed" in order_in_words([4, 3, 2, 1, 0], range(5))
    assert threshold(12) == pytest.approx(np.sqrt(2 * np.log(126 / 1e-3)))


def shown(*arguments):
    result = CliRunner().invoke(app, ["brdf", "lights", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    return result.output


def test_the_command(tmp_path):
    text = shown(write(tmp_path, swapped(UP, (1, 4))))
    assert re.search(r"light +from camera, deg", text) and "elsewhere" in text
    assert "lights 1 and 4 exchanged" in text and "all together: residual" in text
    record = json.loads(shown(tmp_path / "rig.toml", "--json"))
    assert len(record["lights"]) == len(LIGHTS) and record["warnings"]


def mirror_rig(folder):
    spots = np.zeros((len(LIGHTS), CAMERA.height, CAMERA.width))
    from synthetic_camera import blinn_phong, lambert, render, sphere_for

    ball = sphere_for(CAMERA, 35.0, (-4.0, 5.0))
    spots = render(CAMERA, ball, LIGHTS, blinn_phong(0.0, 1.0, 3000.0))
    for k, image in enumerate(spots):
        Image.fromarray(np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)).save(folder / f"m{k}.png")
    back = render(CAMERA, ball, LIGHTS[:1], lambert(), background=9.0)[0] > 4.5
    Image.fromarray((back * 255).astype(np.uint8)).save(folder / "outline.png")
    names = ", ".join(f'"m{k}.png"' for k in range(len(spots)))
    lines = ["format = 1", "[camera]", 'kind = "pinhole"', f"focal_px = {CAMERA.matrix[0, 0]}"]
    lines += [f"centre_px = {[float(x) for x in CAMERA.matrix[:2, 2]]}"]
    lines += ["[[mirror]]", 'outline = "outline.png"', "radius_mm = 20.0", f"images = [{names}]"]
    (folder / "rig.toml").write_text("\n".join(lines))


def test_mirror_balls_need_no_sphere_and_no_light(tmp_path):
    mirror_rig(tmp_path)
    found = light_table(tmp_path)
    for light, row in zip(LIGHTS, found.table.to_dict("records"), strict=True):
        there = np.array([row["x"], row["y"], row["z"]])
        # A broad lobe stands in for a mirror: its peak lies within some degrees.
        assert np.rad2deg(np.arccos(light.direction @ there)) < 4
    assert "source below, sr" in shown(tmp_path)
    with pytest.raises(InputError, match="must be one at least to extract"):
        open_rig(tmp_path)
    (tmp_path / "rig.toml").write_text('format = 1\n[camera]\nkind = "orthographic"\n')
    with pytest.raises((InputError, ConfigError), match="must be one at least"):
        open_rig(tmp_path)
