"""`livlab fractions` end to end."""

import csv

import numpy as np
import pytest
import tifffile
from typer.testing import CliRunner

from livlab.cli import app
from livlab.errors import InputError

RUN = CliRunner()


@pytest.fixture
def capsule(tmp_path):
    """Three pages: elastin on the top 10, 20, 40 of 100 rows; collagen on the left half of the second."""
    pages = np.zeros((3, 100, 80, 3), np.uint8)
    for k, rows in enumerate((10, 20, 40)):
        pages[k, :rows, :, 1] = 150
    pages[1, :, :40, 0] = pages[1, :, :40, 2] = 150
    path = tmp_path / "capsule.tif"
    tifffile.imwrite(path, pages, photometric="rgb")
    return path


def run(*arguments):
    return RUN.invoke(app, ["fractions", *map(str, arguments)])


def rows(path):
    with path.open() as stream:
        return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(stream)]


def test_sublayers(capsule, tmp_path):
    out = tmp_path / "table.csv"
    result = run(capsule, "--layers", "0,65,72,100", "-o", out)
    assert result.exit_code == 0, result.output
    assert "65–72 %" in result.output
    got = rows(out)
    assert [(r["depth_from"], r["depth_to"]) for r in got] == [(0.0, 0.65), (0.65, 0.72), (0.72, 1.0)]
    for row, expected in zip(got, (0.1, 0.2, 0.4), strict=True):
        assert abs(row["elastin"] - expected) <= 0.05 * row["elastin_error"]


def test_depths(capsule, tmp_path):
    out = tmp_path / "table.csv"
    for depths in ("0,40,80", "0:40"):
        result = run(capsule, "--stack", depths, "--thickness-um", "80", "--layers", "0,50,100", "-o", out)
        assert result.exit_code == 0, result.output
        got = rows(out)
        assert abs(got[0]["elastin"] - 0.15) <= 0.05 * got[0]["elastin_error"]
        assert abs(got[1]["elastin"] - 0.30) <= 0.05 * got[1]["elastin_error"]


def test_without_depths_pages_are_only_listed(capsule):
    result = run(capsule)
    assert result.exit_code == 0
    assert "share of thickness" not in result.output


def test_channel_and_roi(capsule, tmp_path):
    out = tmp_path / "t.csv"
    result = run(
        capsule, "--channel", "elastin=magenta", "--channel", "collagen=green", "--roi", "40,0,40,100",
        "--layers", "0,20,50,100", "-o", out,
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert [row["elastin"] for row in rows(out)] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--threshold", "high"], "must be a number"),
        (["--threshold", "300"], "threshold"),
        (["--roi", "0,0,500,500"], "must lie inside"),
        (["--channel", "fat=green"], "elastin=COLOUR"),
        (["--channel", "elastin=cyan"], "channel"),
        (["--layers", "0,50"], "shares for 3 pages"),
        (["--stack", "0,a,2"], "must be a number"),
        (["--stack", "0:0"], "rising depths"),
        (["-o", "t.xlsx"], ".csv or .toml"),
        (["-o", "t.csv"], "need depths"),
    ],
)
def test_bad_options_name_the_trouble(capsule, arguments, says):
    result = run(capsule, *arguments)
    assert result.exit_code != 0
    assert isinstance(result.exception, InputError)
    assert says in str(result.exception)
