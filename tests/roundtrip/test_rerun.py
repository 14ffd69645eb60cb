"""`livlab rerun`: a run from its manifest alone, the same bytes, and what is said where they are not the same."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from fuzz.seeds import user_meta
from livlab import datasets
from livlab.cli import app
from livlab.config import parse_experiment
from livlab.errors import DatasetError, InputError
from livlab.kinds.again import read_original, run_again
from livlab.kinds.execute import execute
from livlab.runs.compare import compare_file, timeless
from livlab.runs.identity import read_manifest

CONFIG = """\
schema = 1
kind = "spectral"
name = "small"
readings = ["consistent", "measured"]
tissue = { variant = "parenchyma_only" }
wavelengths = { list_nm = [500, 600, 700] }
instrument = { kind = "hyperspectral-camera" }
solver = { kind = "adding-doubling", tolerance = 1e-3 }
processing = { moving_average = 1, interpolate_nm = 50.0 }
[[reference]]
label = "my liver"
dataset = "my_liver"
[[criterion]]
metric = "rmse"
against = "my liver"
reference = 0.0
tolerance = 0.5
"""


def write_dataset(root: Path, last: float, version: str = "1") -> None:
    folder = root / "my_liver"
    folder.mkdir(parents=True, exist_ok=True)
    table = f"wavelength_nm,reflectance\n450,0.1\n600,0.2\n750,{last}\n"
    (folder / "table.csv").write_text(table)
    (folder / "meta.toml").write_text(user_meta(table.encode(), version=version))


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A run in a folder with blanks and letters beyond ASCII, and its dataset."""
    place = tmp_path_factory.mktemp("fígado de José")
    write_dataset(place / "data", 0.4)
    old = os.environ.get("LIVLAB_DATA")
    os.environ["LIVLAB_DATA"] = str(place / "data")
    yield execute(parse_experiment(CONFIG), base=place / "corridas às 10", report=False).folder
    if old is None:
        del os.environ["LIVLAB_DATA"]
    else:
        os.environ["LIVLAB_DATA"] = old


@pytest.fixture
def run(first: Path, tmp_path: Path) -> Path:
    """A copy of the run that a test may damage."""
    return Path(shutil.copytree(first, tmp_path / "ran ü" / first.name))


@pytest.fixture
def data(first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the user's datasets that a test may damage."""
    root = Path(shutil.copytree(datasets.user_root() or tmp_path, tmp_path / "data"))
    monkeypatch.setenv("LIVLAB_DATA", str(root))
    return root


def change(run: Path, **entries: Any) -> None:
    manifest = read_manifest(run) | entries
    (run / "manifest.json").write_text(json.dumps({k: v for k, v in manifest.items() if v is not None}))


def call(*words: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, list(words))
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


def test_a_run_comes_out_the_same_byte_by_byte(run: Path) -> None:
    code, said = call("rerun", str(run), "--no-report")
    assert code == 0
    assert "The results are the same." in said
    new = Path(said.strip().splitlines()[-1])
    assert new.parent.name == "reruns"
    assert new.name == run.name
    for name in ("result.nc", "spectra.csv", "curves.csv", "budget.csv", "metrics.csv"):
        assert (new / name).read_bytes() == (run / name).read_bytes()
    told = json.loads((new / "rerun.json").read_text())
    assert told["same"] is True
    assert told["differences"] == []
    verdicts = {f["name"]: f["verdict"] for f in told["files"]}
    assert verdicts["result.nc"] == "same"
    assert verdicts["claims.csv"] in ("same", "same but for times")
    assert read_manifest(new)["digest"] == read_manifest(run)["digest"]


def test_the_manifest_alone_is_enough(run: Path, tmp_path: Path) -> None:
    alone = tmp_path / "posted" / "manifest.json"
    alone.parent.mkdir()
    shutil.copy(run / "manifest.json", alone)
    again = run_again(read_original(alone), report=False)
    assert again.same
    assert again.differences == ()
    assert (again.folder / "result.nc").read_bytes() == (run / "result.nc").read_bytes()


def test_a_manifest_without_the_experiment_takes_the_config_beside_it(run: Path) -> None:
    change(run, experiment=None, results=None)
    assert run_again(read_original(run), report=False).same
    (run / "config.toml").write_text((run / "config.toml").read_text().replace("seed = 1", "seed = 2"))
    with pytest.raises(InputError, match="its hash differs"):
        read_original(run)


def test_versions_and_machine_that_differ_are_named_though_the_results_agree(run: Path) -> None:
    packages = read_manifest(run)["packages"] | {"numpy": "0.1", "gone": "1.0"}
    change(run, packages=packages, livlab="0.0.1", code="0" * 16, platform="Amiga", processor="68000")
    code, said = call("rerun", str(run), "--no-report")
    assert code == 0
    told = " ".join(said.split())
    for text in ("livlab: 0.0.1 then", "numpy: 0.1 then", "gone: 1.0 then, none now", "platform: Amiga then"):
        assert text in told
    assert f"code: {'0' * 16} then" in told
    assert "processor: 68000 then" in told


def test_a_dataset_of_other_numbers_is_named_and_what_it_moved(run: Path, data: Path) -> None:
    write_dataset(data, 0.5, "2")
    code, said = call("rerun", str(run), "--json")
    assert code == 1
    told = json.loads(said)
    assert [d["what"] for d in told["differences"]] == ["dataset my_liver"]
    files = {f["name"]: f for f in told["files"]}
    assert files["spectra.csv"]["verdict"] == "same"  # the light does not know the reference
    assert files["metrics.csv"]["verdict"] == "differs"
    assert "reference" in files["result.nc"]["detail"]
    assert Path(told["folder"]).name != run.name


def test_a_tampered_dataset_stops_it_and_the_message_names_it(run: Path, data: Path) -> None:
    table = data / "my_liver" / "table.csv"
    table.write_text(table.read_text().replace("0.2", "0.3"))
    change(run, livlab="0.0.1")
    with pytest.raises(DatasetError, match=r"my_liver has been changed.*livlab: 0.0.1 then.*my_liver"):
        call("rerun", str(run))
    shutil.rmtree(data / "my_liver")
    with pytest.raises(DatasetError, match="no dataset 'my_liver'") as told:
        call("rerun", str(run))
    sha256 = read_manifest(run)["datasets"]["my_liver"]
    assert f"Ask the authors of the run for the folder of my_liver (SHA-256 of its table.csv: {sha256})" in str(
        told.value
    )
    assert str(data) in told.value.remedy


def test_numbers_that_differ_are_told_with_their_size(run: Path) -> None:
    path = run / "spectra.csv"
    rows = path.read_text().splitlines()
    cells = rows[1].split(",")
    cells[2] = str(2 * float(cells[2]))
    path.write_text("\n".join([rows[0], ",".join(cells), *rows[2:]]) + "\n")
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    manifest = read_manifest(run)
    change(
        run, files=manifest["files"] | {"spectra.csv": sha256}, results=manifest["results"] | {"spectra.csv": sha256}
    )
    code, said = call("rerun", str(run), "--no-report")
    assert code == 1
    assert "The results differ." in said
    assert "reflectance" in said
    assert "50 %" in " ".join(said.split())  # of the larger: what was doubled is twice what is


def test_a_changed_seed_does_not_pass(run: Path) -> None:
    text = read_manifest(run)["experiment"]
    assert "\nseed = 1\n" in text
    change(run, experiment=text.replace("\nseed = 1\n", "\nseed = 2\n"))
    again = run_again(read_original(run), report=False)
    assert not again.same
    assert [d.what for d in again.differences] == ["experiment"]
    assert "attributes seed" in next(f.detail for f in again.files if f.name == "result.nc")


def test_a_file_changed_since_the_run_does_not_hide_that_the_result_is_the_same(run: Path) -> None:
    (run / "spectra.csv").write_text("reading\nmine\n")
    (run / "result.nc").unlink()
    again = run_again(read_original(run), report=False)
    assert again.same
    assert again.changed == ("result.nc", "spectra.csv")


def test_a_claim_changed_by_hand_is_found(run: Path) -> None:
    claims = run / "claims.csv"
    verdict = "PASS" if ",PASS," in claims.read_text() else "FAIL"
    claims.write_text(claims.read_text().replace(f",{verdict},", ",MISSING,", 1))
    code, said = call("rerun", str(run), "--no-report")
    told = " ".join(said.split())
    assert code == 1
    assert "changed since the run: claims.csv." in told
    assert "The results are the same." in told
    assert json.loads(call("rerun", str(run), "--json", "--no-report")[1])["changed"] == ["claims.csv"]


@pytest.mark.parametrize("share", [0.0, 0.4, 0.999])
def test_a_manifest_that_was_cut_off_is_refused(run: Path, share: float) -> None:
    path = run / "manifest.json"
    raw = path.read_bytes()
    path.write_bytes(raw[: int(share * len(raw.rstrip()))])
    with pytest.raises(InputError, match="cut off or damaged") as told:
        read_original(run)
    assert "config.toml" in told.value.remedy


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[]", "is no manifest"),
        ('{"digest": 3}', "lacks digest, datasets, files, packages"),
        ("[" * 100_000, "cannot be read|cut off"),
    ],
)
def test_what_is_no_manifest_is_refused(run: Path, text: str, said: str) -> None:
    (run / "manifest.json").write_text(text)
    with pytest.raises(InputError, match=said):
        read_original(run)


@pytest.mark.parametrize("entry", [{"../../secret": "0"}, {"a.csv": 3}, ["a.csv"]])
def test_a_manifest_names_nothing_outside_its_folder(run: Path, entry: object) -> None:
    change(run, files=entry)
    with pytest.raises(InputError, match="lacks files"):
        read_original(run)


def test_a_run_that_is_not_there_or_not_done_is_refused(run: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has no manifest\.json"):
        read_original(tmp_path / "nowhere")
    change(run, status="partial")
    with pytest.raises(InputError, match="did not finish") as told:
        read_original(run)
    assert "livlab run" in told.value.remedy


def test_the_run_itself_is_never_overwritten(run: Path) -> None:
    before = (run / "manifest.json").read_bytes()
    with pytest.raises(InputError, match="holds the run itself"):
        run_again(read_original(run), run.parent / "." / "", report=False)
    assert (run / "manifest.json").read_bytes() == before


def test_times_alone_do_not_count(tmp_path: Path) -> None:
    old, new = tmp_path / "a.csv", tmp_path / "b.csv"
    old.write_text('name,value,seconds\n"x, y",1,0.5\n')
    new.write_text('name,value,seconds\n"x, y",1,0.75\n')
    assert compare_file("claims.csv", old, new).verdict == "same but for times"
    new.write_text('name,value,seconds\n"x, y",2,0.5\n')
    assert compare_file("claims.csv", old, new).verdict == "differs"
    assert timeless("a.json", b'{"seconds": 1, "a": [{"seconds": 2, "b": 3}]}') == b'{"a": [{"b": 3}]}'
    assert timeless("a.png", b"seconds") == b"seconds"


def test_seconds_in_a_grids_attributes_do_not_count(tmp_path: Path) -> None:
    import numpy as np
    import xarray as xr

    def written(name: str, seconds: float, value: float, unit: str = "1") -> Path:
        data = xr.Dataset(
            {
                "image": (("row", "channel"), np.array([[1.0, value], [3.0, 4.0]])),
                "image_se": (("row", "channel"), np.full((2, 2), 0.5)),
            },
            {"channel": ["R", "G"]},
            {"seconds": seconds, "units": unit},
        )
        xr.DataTree.from_dict({"/": data, "/body": data}).to_netcdf(tmp_path / name, engine="h5netcdf")
        return tmp_path / name

    first = written("a.nc", 1.0, 2.0)
    assert compare_file("image.nc", first, written("b.nc", 2.0, 2.0)).verdict == "same but for times"
    other = compare_file("image.nc", first, written("c.nc", 2.0, 2.5))
    assert other.verdict == "differs"
    assert "image: up to 0.5 at 2.5, 1 standard errors" in other.detail
    assert "seconds" not in other.detail
    assert "attributes units" in compare_file("image.nc", first, written("d.nc", 1.0, 2.0, "m")).detail
    broken = tmp_path / "e.nc"
    broken.write_bytes(first.read_bytes()[:500])
    assert compare_file("image.nc", first, broken).verdict == "differs"
    assert timeless("e.nc", broken.read_bytes()) == broken.read_bytes()
