"""`livlab mesh` end to end."""

import numpy as np
import pytest
from typer.testing import CliRunner

from livlab.cli import app
from livlab.errors import InputError
from livlab.model.shapes import TriangleMesh, check, read_mesh, sphere, write_meshes

RUN = CliRunner()


def run(*arguments):
    return RUN.invoke(app, ["mesh", *map(str, arguments)])


@pytest.fixture
def ball(tmp_path):
    path = tmp_path / "ball.ply"
    write_meshes({path: sphere(10.0, resolution_mm=1.5)})
    return path


@pytest.fixture
def volume(tmp_path):
    index = np.indices((24, 24, 24)) - 11.5
    path = tmp_path / "seg.npz"
    np.savez(path, labels=np.where((index**2).sum(axis=0) < 64, 4, 0).astype(np.uint8), spacing_mm=[1.0, 1.0, 1.0])
    return path


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl"])
def test_a_mesh_becomes_two(ball, tmp_path, suffix):
    result = run(ball, "--thickness", 1.0, "-o", tmp_path / f"made{suffix}")
    assert result.exit_code == 0, result.output
    outer, inner = (read_mesh(tmp_path / f"made-{which}{suffix}") for which in ("outer", "inner"))
    assert check(outer, inner) == ()
    assert outer.extent[0] - inner.extent[0] == pytest.approx(2.0, rel=0.05)
    for word in ("faces", "extent", "volume", "area", "watertight", "shell", " s."):
        assert word in result.output


def test_a_segmentation_with_all_its_options(volume, tmp_path):
    wanted = {
        "label": 4,
        "smoothing": 0.8,
        "faces": 800,
        "how": "normal",
        "thickness": 0.3,
        "format": "obj",
        "keep": "all",
    }
    options = [word for name, value in wanted.items() for word in (f"--{name}", value)]
    result = run(volume, *options, "-o", tmp_path / "made")
    assert result.exit_code == 0, result.output
    outer, inner = (read_mesh(tmp_path / f"made-{which}.obj") for which in ("outer", "inner"))
    assert len(outer.faces) <= 800
    assert check(outer, inner) == ()
    assert outer.volume == pytest.approx(4 / 3 * np.pi * 8**3, rel=0.06)


def test_scaling_reports_what_came_of_it(ball, tmp_path):
    result = run(ball, "--thickness", 0.5, "--how", "scale", "-o", tmp_path / "made")
    assert result.exit_code == 0, result.output
    assert "0 % of area" in result.output


def test_units(ball, tmp_path):
    assert run(ball, "--unit", "cm", "--thickness", 5, "-o", tmp_path / "made").exit_code == 0
    assert read_mesh(tmp_path / "made-outer.ply").extent[0] == pytest.approx(200.0, rel=0.01)


def test_nothing_is_overwritten_unasked(ball, tmp_path):
    (tmp_path / "made-inner.ply").write_text("precious")
    result = run(ball, "--thickness", 0.5, "-o", tmp_path / "made")
    assert isinstance(result.exception, InputError)
    assert "exists already" in result.exception.message
    assert (tmp_path / "made-inner.ply").read_text() == "precious"
    assert not (tmp_path / "made-outer.ply").exists()
    assert run(ball, "--thickness", 1.0, "-o", tmp_path / "made", "--force").exit_code == 0
    assert read_mesh(tmp_path / "made-inner.ply").volume > 0


def test_a_bad_mesh_writes_nothing(tmp_path):
    whole = sphere(10.0, resolution_mm=3.0)
    write_meshes({tmp_path / "open.ply": TriangleMesh(whole.vertices, whole.faces[3:])})
    result = run(tmp_path / "open.ply", "-o", tmp_path / "made")
    assert isinstance(result.exception, InputError)
    assert "open edges" in result.exception.message
    assert [p.name for p in tmp_path.iterdir()] == ["open.ply"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--how", "melt"], "distance, normal or scale"),
        (["--thickness", "30"], "leaves nothing"),
        (["--format", "fbx"], "must be one of"),
        (["--smoothing", "1"], "for segmentations"),
        (["--unit", "ell"], "must be one of"),
        (["-o", "nowhere/made"], "no folder"),
        (["--faces", "3"], "at least 100"),
    ],
)
def test_options_that_make_no_sense(ball, tmp_path, arguments, said):
    options = arguments if "-o" in arguments else [*arguments, "-o", tmp_path / "made"]
    result = run(ball, *options)
    assert isinstance(result.exception, InputError), result.output
    assert said in result.exception.message
    assert [p.name for p in tmp_path.iterdir()] == ["ball.ply"]


@pytest.mark.parametrize("spacing", ["a,b,c", "1,2", "0"])
def test_spacings_that_cannot_be(volume, tmp_path, spacing):
    result = run(volume, "--spacing", spacing, "-o", tmp_path / "made")
    assert isinstance(result.exception, InputError)


def test_a_spacing_overrides_the_files(volume, tmp_path):
    result = run(volume, "--spacing", "2", "--thickness", 1.5, "-o", tmp_path / "made")
    assert result.exit_code == 0, result.output
    assert read_mesh(tmp_path / "made-outer.ply").extent[0] == pytest.approx(32.0, rel=0.06)


@pytest.mark.slow
def test_the_liver_made_by_code(tmp_path):
    result = run("liver", "--thickness", 0.1, "-o", tmp_path / "liver")
    assert result.exit_code == 0, result.output
    outer, inner = (read_mesh(tmp_path / f"liver-{which}.ply") for which in ("outer", "inner"))
    assert check(outer, inner) == ()
    assert outer.extent[0] == pytest.approx(140.0)
