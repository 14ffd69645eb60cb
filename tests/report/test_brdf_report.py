"""A BRDF run from its file to its page, on small spheres."""

import csv
import json

import pytest
import xarray as xr

from livlab.config import parse_experiment
from livlab.kinds.execute import execute
from livlab.kinds.report import build_report

TEXT = """
schema = 1
kind = "brdf"
name = "small"
title = "Two <b>materials</b>"
seed = 3
[rig]
radius_px = 40.0
[rig.lights]
count = 3
last_deg = 80.0
[[material]]
name = "matt"
bsdf = { type = "diffuse", reflectance = [0.5, 0.4, 0.3] }
fit = { model = "lambert" }
true = { "kd[R]" = 0.5, "kd[G]" = 0.4, "kd[B]" = 0.3 }
[[material]]
name = "metal & <i>"
bsdf = { type = "roughconductor", distribution = "ggx", alpha = 0.3, material = "Au" }
[[criterion]]
metric = "relative rms"
tolerance = 0.005
[[criterion]]
metric = "relative rms"
pose = "outline"
of = "matt"
tolerance = 0.01
[[criterion]]
metric = "parameter error"
parameter = "kd"
tolerance = 0.001
[[criterion]]
metric = "parameter error"
parameter = "alpha"
of = "metal & <i>"
tolerance = 0.01
"""


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    return execute(parse_experiment(TEXT), base=tmp_path_factory.mktemp("runs"), command="livlab run small.toml")


def rows(folder, name):
    with (folder / name).open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_claims_hold_and_what_is_unknown_is_missing(outcome):
    verdicts = {c["criterion"]: c["verdict"] for c in outcome.claims}
    assert verdicts["relative rms matt vs bsdf.eval, known pose"] == "PASS"
    assert verdicts["relative rms matt vs bsdf.eval, outline pose"] == "PASS"
    assert verdicts["kd relative error matt vs bsdf.eval, known pose"] == "PASS"
    assert verdicts["alpha relative error metal & <i> vs bsdf.eval, known pose"] == "MISSING"
    notes = json.loads((outcome.folder / "manifest.json").read_text(encoding="utf-8"))["claim_notes"]
    assert notes["alpha relative error metal & <i> vs bsdf.eval, known pose"] == "nothing was fitted"


def test_tables_hold_both_poses_and_every_stage(outcome):
    samples = rows(outcome.folder, "samples.csv")
    assert [(r["material"], r["pose"]) for r in samples] == [
        (m, p) for m in ("matt", "metal & <i>") for p in ("known", "outline")
    ]
    assert all(0 < float(r["relative_rms"]) <= float(r["worst"]) for r in samples)
    poses = rows(outcome.folder, "poses.csv")
    assert all(float(r["centre_off_px"]) < 0.05 and abs(float(r["radius_off_px"])) < 0.1 for r in poses)
    fits = rows(outcome.folder, "fits.csv")
    assert {r["parameter"] for r in fits} == {"kd[R]", "kd[G]", "kd[B]"}
    assert all(float(r["low"]) <= float(r["value"]) <= float(r["high"]) for r in fits if r["pose"] == "known")
    assert {r["stage"] for r in rows(outcome.folder, "costs.csv")} == {"render", "pose", "extract", "fit"}


def test_the_result_holds_lobes_and_cells(outcome):
    with xr.open_dataset(outcome.folder / "result.nc", engine="h5netcdf") as result:
        assert result["measured"].dims == ("material", "incidence", "theta", "channel")
        assert float(result["true"].sel(material="matt").isel(channel=0).mean()) == pytest.approx(
            0.5 / 3.14159, rel=1e-3
        )
        assert int(result["cell_count"].sum()) > 5_000


def test_the_page_shows_it_all_escaped_and_can_be_built_again(outcome):
    page = outcome.report.read_text(encoding="utf-8")
    for section in ("The spheres", "The samples", "Lobes in the plane of incidence", "The fits", "What it cost"):
        assert f">{section}</h2>" in page
    assert "<b>materials" not in page
    assert "metal &amp; &lt;i&gt;" in page
    assert "<i>" not in page.replace("<i></i>", "")
    assert page.count('src="data:image/png;base64,') == 2
    again = build_report(outcome.folder).read_text(encoding="utf-8")
    assert again == page


def test_a_criterion_that_is_wrong_fails(tmp_path):
    text = TEXT.replace("count = 3", "count = 1").split('[[material]]\nname = "metal')[0] + (
        '[[criterion]]\nmetric = "relative rms"\nreference = 0.5\ntolerance = 0.001\n'
    )
    found = execute(parse_experiment(text), base=tmp_path, report=False)
    assert [c["verdict"] for c in found.claims] == ["FAIL"]
    assert found.report is None
    assert execute(parse_experiment(text), base=tmp_path, report=False).cached
