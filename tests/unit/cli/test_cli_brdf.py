"""livlab brdf: from a rig to samples, fits, comparisons, figures and files; output whole or not there."""

import json

import numpy as np
import pytest
import tifffile
from PIL import Image
from synthetic_camera import Faults, blinn_phong, camera, render, ring, sphere_for
from typer.testing import CliRunner

from livlab.brdf.files.formats import read_brdf
from livlab.cli import brdf
from livlab.errors import LivlabError

RUNNER = CliRunner()
KD, KS, EXPONENT = 0.3, 0.15, 40.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rig")
    cam = camera(120, 110, focal_px=400.0)
    sphere = sphere_for(cam, 38.0)
    lights = ring(4, 40)
    faults = Faults(gain=1e-5, read=1e-3, bits=16)
    for k, image in enumerate(render(cam, sphere, lights, blinn_phong(KD, KS, EXPONENT))):
        tifffile.imwrite(folder / f"{k}.tif", faults(image, k), photometric="minisblack")
    back = [type(lights[0])(np.ones(1), direction=sphere.centre_mm / np.linalg.norm(sphere.centre_mm))]
    mask = render(cam, sphere, back, blinn_phong(), background=1.0)[0]
    Image.fromarray(np.round(255 * (1 - mask)).astype(np.uint8)).save(folder / "mask.png")
    text = ["format = 1", "[camera]", 'kind = "pinhole"', "focal_px = 400.0"]
    text += [f"centre_px = [{cam.matrix[0, 2]}, {cam.matrix[1, 2]}]", "[sphere]", "radius_mm = 20.0"]
    text += ['outline = "mask.png"', "[white]", f"value = [{1 / np.pi}]", "reflectance = 1.0"]
    for k, light in enumerate(lights):
        text += ["[[light]]", f'images = ["{k}.tif"]', f"direction = {light.direction.tolist()}", "sd_deg = 0.3"]
    (folder / "rig.toml").write_text("\n".join(text))
    done = RUNNER.invoke(brdf.app, ["extract", str(folder), "-o", str(folder / "s.nc")], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return folder


def run(*arguments):
    done = RUNNER.invoke(brdf.app, [str(a) for a in arguments])
    if isinstance(done.exception, LivlabError):
        return done.exception.exit_code, str(done.exception)
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return done.exit_code, done.output


def test_extract_tells_what_was_found_and_what_not(folder, tmp_path):
    code, said = run("extract", folder / "rig.toml", "-o", tmp_path / "s.nc")
    assert code == 0, said
    for text in ("absolute, by a white reference", "not corrected: vignetting", "4 distant", "estimated"):
        assert text in said
    samples = read_brdf(tmp_path / "s.nc")
    assert samples.sizes["light_index"] == 4
    assert samples.attrs["wi"].startswith("unit vector from the surface to the light")


def test_extract_as_json_with_a_budget(folder, tmp_path):
    code, said = run(
        "extract", folder, "-o", tmp_path / "s.csv", "--most", 3000, "--json", "--budget", "lambert+blinn-phong"
    )
    assert code == 0, said
    record = json.loads(said)
    assert record["samples"] <= 3000
    sources = {row["source"] for row in record["budget"]}
    assert {"light direction", "pose", "linearity", "noise", "footprint", "white reference"} <= sources
    assert read_brdf(tmp_path / "s.csv").sizes["sample"] == record["samples"]


def test_the_budget_is_printed(folder, tmp_path):
    code, said = run("extract", folder, "-o", tmp_path / "s.nc", "--most", 2000, "--budget", "lambert")
    assert code == 0, said
    assert "Error budget" in said
    assert "white reference" in said


def test_fit_finds_the_material(folder, tmp_path):
    code, said = run("fit", folder / "s.nc", "lambert+blinn-phong", "-o", tmp_path / "f.json")
    assert code == 0, said
    assert "blinn-phong" in said
    found = {row["parameter"]: row["value"] for row in json.loads((tmp_path / "f.json").read_text())["parameters"]}
    kd = next(v for k, v in found.items() if k.startswith("kd"))
    assert kd == pytest.approx(KD, rel=0.02)
    assert next(v for k, v in found.items() if k.startswith("exponent")) == pytest.approx(EXPONENT, rel=0.05)


def test_models_are_ranked(folder):
    code, said = run("compare", folder / "s.nc", "-m", "lambert", "-m", "lambert+blinn-phong", "--json")
    assert code == 0, said
    rows = json.loads(said)
    assert rows[0]["model"] == "lambert+blinn-phong"
    assert rows[1]["delta_bic"] > 100


def test_samples_are_converted_and_compared(folder, tmp_path):
    assert run("convert", folder / "s.nc", tmp_path / "s.csv")[0] == 0
    code, said = run("compare", folder / "s.nc", tmp_path / "s.csv", "--json")
    assert code == 0, said
    assert json.loads(said)[0]["relative"] < 0.08  # samples against the mean of their cell


@pytest.mark.slow
def test_files_are_converted_and_compared(folder, tmp_path):
    for suffix in (".csv", ".binary"):
        assert run("convert", folder / "s.nc", tmp_path / f"s{suffix}")[0] == 0
    code, said = run("compare", folder / "s.nc", tmp_path / "s.csv", tmp_path / "s.binary", "--json")
    assert code == 0, said
    csv, merl = json.loads(said)
    # Merged in cells both; the samples themselves scatter in a cell.
    assert csv["relative"] < 0.08
    assert merl["relative"] < 0.08
    assert merl["scale"] == pytest.approx(1.0, abs=0.02)
    assert merl["pearson"] > 0.95


@pytest.mark.parametrize(("suffix", "which"), [(".png", "lambert+blinn-phong"), (".svg", None)])
def test_plots(folder, tmp_path, suffix, which):
    more = [] if which is None else ["-m", which]
    assert run("plot", folder / "s.nc", "-o", tmp_path / f"p{suffix}", *more)[0] == 0
    if suffix == ".png":
        picture = np.asarray(Image.open(tmp_path / "p.png").convert("L"))
        assert picture.shape[0] > 600
        assert np.std(picture) > 10
    else:
        assert "holes grey" in (tmp_path / "p.svg").read_text()


@pytest.mark.slow
def test_a_table_without_pixels_is_plotted_too(folder, tmp_path):
    run("convert", folder / "s.nc", tmp_path / "s.binary")
    assert run("plot", tmp_path / "s.binary", "-o", tmp_path / "p.png")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("extract", "RIG", "-o", "OUT/a.txt"), "must end in one of"),
        (("extract", "RIG", "-o", "OUT/none/a.nc"), "no folder"),
        (("extract", "OUT", "-o", "OUT/a.nc"), "is no rig file"),
        (("extract", "RIG", "-o", "OUT/a.nc", "--max-angle", "95"), "between 0 and 90"),
        (("extract", "RIG", "-o", "OUT/a.nc", "--most", "3"), ">= 100"),
        (("extract", "RIG", "-o", "OUT/a.nc", "--budget", "lambrt"), "no lobe"),
        (("extract", "RIG", "-o", "OUT/a.nc", "--budget", "lambert", "--loss", "l3"), "--loss"),
        (("fit", "SAMPLES", "lambrt"), "no lobe"),
        (("fit", "SAMPLES", "lambert", "--loss", "l3"), "--loss"),
        (("fit", "OUT/none.nc", "lambert"), "none.nc"),
        (("compare", "SAMPLES"), "one file and models, or several files"),
        (("plot", "SAMPLES", "-o", "OUT/a.gif"), "must end in one of"),
        (("convert", "SAMPLES", "OUT/a.bsdf", "--holes", "guess"), "--holes"),
        (("convert", "SAMPLES", "OUT/a.bsdf"), "hole"),
    ],
)
def test_what_is_refused_leaves_nothing_behind(folder, tmp_path, arguments, said):
    names = {"RIG": str(folder), "SAMPLES": str(folder / "s.nc")}
    code, text = run(*(names.get(a, a.replace("OUT", str(tmp_path))) for a in arguments))
    assert code == 2
    assert said in text
    assert list(tmp_path.iterdir()) == []
