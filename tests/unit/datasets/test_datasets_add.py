"""Adding a dataset: usable by name afterwards, and nothing half-written whatever fails."""

import errno
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from livlab import datasets
from livlab.datasets import load
from livlab.datasets.add import add, existing_meta
from livlab.datasets.draft import Draft, read_draft
from livlab.errors import DatasetError, EnvironmentProblem, InputError

ABOUT = {"title": "mine", "source": "own measurement", "kind": "tabulated"}


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("LIVLAB_DATA", str(tmp_path / "mine"))
    return tmp_path / "mine"


@pytest.fixture
def draft(tmp_path: Path) -> Draft:
    file = tmp_path / "my file.csv"
    file.write_text("wavelength (nm);Réflectance\n500;0,1\n600;0,3\n")
    return read_draft(file, columns=["reflectance:1"])


def left_in(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir()) if folder.exists() else []


def test_usable_by_name_afterwards(mine: Path, draft: Draft) -> None:
    folder = add(draft, name="my_liver", doi="10.1000/x", relative_uncertainty=0.05, notes="n", year=2026, **ABOUT)
    assert folder == mine / "my_liver"
    liver = load("my_liver")
    assert liver.interpolate("reflectance", 550.0) == pytest.approx(0.2)
    assert liver.meta.columns["reflectance"].description == "Réflectance"
    assert liver.meta.read_in == "user's file my file.csv"
    assert liver.provenance()["doi"] == "10.1000/x"
    assert "my_liver" in datasets.names()
    assert datasets.check("my_liver").ok
    assert left_in(mine) == ["my_liver"]


def test_a_reference_that_was_not_available_is_after_it_is_added(mine: Path, draft: Draft) -> None:
    add(draft, name="nachabe2011_liver", **ABOUT)
    assert load("nachabe2011_liver").range_nm == (500.0, 600.0)


def test_project_folder_and_parameter_table(tmp_path: Path, mine: Path) -> None:
    file = tmp_path / "brdf.csv"
    file.write_text("theta_deg,brdf\n10,0.1\n0,0.2\n")
    table = read_draft(file, unit="1", wavelength=False)
    add(table, name="my_brdf", into=tmp_path / "beside" / "datasets", **ABOUT)
    dataset = load("my_brdf", search=[tmp_path / "beside" / "datasets"])
    assert not dataset.is_spectrum
    assert list(dataset.column("theta_deg")) == [10, 0]
    assert not mine.exists()
    with pytest.raises(DatasetError, match="no dataset"):
        load("my_brdf")


def test_names_that_are_taken(mine: Path, draft: Draft) -> None:
    with pytest.raises(InputError, match="livlab's own"):
        add(draft, name="bile_nachabe2011", **ABOUT)
    with pytest.raises(InputError, match="livlab's own datasets are"):
        add(draft, name="mine", into=datasets.builtin_root(), **ABOUT)
    add(draft, name="mine", **ABOUT)
    with pytest.raises(InputError, match="is taken"):
        add(draft, name="mine", **ABOUT)
    add(draft, name="mine", replace_existing=True, **{**ABOUT, "title": "second"})
    assert load("mine").meta.title == "second"
    assert load("mine").meta.version == "2"
    assert left_in(mine) == ["mine"]


@pytest.mark.parametrize("name", ["", "..", "../x", "/etc/x", "a/b", "Ab", "a.b", "x" * 65, ".adding-x"])
def test_names_that_could_leave_the_folder(mine: Path, draft: Draft, name: str) -> None:
    with pytest.raises(InputError, match="dataset name"):
        add(draft, name=name, **ABOUT)
    assert not mine.exists()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"kind": "guessed"}, "kind = 'guessed'"),
        ({"source": "  "}, "source"),
        ({"title": ""}, "title"),
        ({"doi": "nature"}, "doi = 'nature'"),
        ({"relative_uncertainty": -1.0}, "uncertainty.relative"),
        ({"relative_uncertainty": float("nan")}, "uncertainty.relative"),
        ({"title": "bad \ud800 text"}, "title"),
    ],
)
def test_metadata_that_does_not_fit(mine: Path, draft: Draft, change: dict[str, object], says: str) -> None:
    with pytest.raises(InputError) as caught:
        add(draft, name="mine", **{**ABOUT, **change})  # type: ignore[arg-type]
    assert says in str(caught.value)
    assert left_in(mine) == []


def test_unit_must_be_known_before_writing(tmp_path: Path, mine: Path) -> None:
    (tmp_path / "f.csv").write_text("wavelength,signal\n500,1\n600,2\n")
    unknown = read_draft(tmp_path / "f.csv")
    with pytest.raises(InputError, match="missing for column signal"):
        add(unknown, name="mine", **ABOUT)
    (tmp_path / "g.csv").write_text("wavelength,reflectance\n500,1\n600,20\n")
    with pytest.raises(InputError, match="looks like percent"):
        read_draft(tmp_path / "g.csv").with_units({"reflectance": "1"})
    assert not mine.exists()


@pytest.mark.parametrize("call", range(2))
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EIO])
def test_a_failing_disk_leaves_nothing(
    mine: Path, draft: Draft, monkeypatch: pytest.MonkeyPatch, call: int, number: int
) -> None:
    calls = iter(range(9))

    def fail(_: int) -> None:
        if next(calls) == call:
            raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(EnvironmentProblem, match="Nothing was changed") as caught:
        add(draft, name="mine", **ABOUT)
    assert "LIVLAB_DATA" in caught.value.remedy
    assert left_in(mine) == []


def test_a_failed_replacement_keeps_the_old_one(mine: Path, draft: Draft, monkeypatch: pytest.MonkeyPatch) -> None:
    add(draft, name="mine", **ABOUT)
    rename = Path.rename

    def fail(self: Path, target: Path) -> Path:
        if target == mine / "mine" and self.name != "old":
            raise OSError(errno.EIO, "I/O error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fail)
    with pytest.raises(EnvironmentProblem):
        add(draft, name="mine", replace_existing=True, **{**ABOUT, "title": "second"})
    assert load("mine").meta.title == "mine"
    assert left_in(mine) == ["mine"]


def test_an_interrupt_leaves_nothing(mine: Path, draft: Draft, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(_: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        add(draft, name="mine", **ABOUT)
    assert left_in(mine) == []


def test_folders_that_cannot_be_written(tmp_path: Path, draft: Draft, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    for place in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/livlab")):
        with pytest.raises(EnvironmentProblem, match="cannot be written"):
            add(draft, name="mine", into=place, **ABOUT)
    monkeypatch.delenv("LIVLAB_DATA", raising=False)
    monkeypatch.setattr("livlab.datasets.catalogue.user_root", lambda: None)
    with pytest.raises(EnvironmentProblem, match="no home folder"):
        add(draft, name="mine", **ABOUT)


def test_what_is_known_of_a_dataset_to_be_replaced(mine: Path, draft: Draft) -> None:
    assert existing_meta("mine") is None
    add(draft, name="mine", **ABOUT)
    assert (existing_meta("mine") or pytest.fail()).source == "own measurement"


@pytest.mark.parametrize(
    ("options", "says"),
    [("size=16k", "No space left on device"), ("ro", "Read-only file system")],
    ids=["full", "read-only"],
)
def test_a_real_full_or_read_only_disk(tmp_path: Path, options: str, says: str) -> None:
    unshare = shutil.which("unshare")
    place = tmp_path / "small"
    place.mkdir()
    probe = [unshare or "", "-rm", "mount", "-t", "tmpfs", "tmpfs", str(place)]
    if unshare is None or subprocess.run(probe, capture_output=True, check=False).returncode:
        pytest.skip("no right to mount a tmpfs in a namespace of one's own")
    (tmp_path / "f.csv").write_text("wavelength,a\n" + "".join(f"{500 + i},{i}\n" for i in range(5000)))
    code = "import sys; from livlab.cli.app import main; sys.argv[0] = 'livlab'; main()"
    shell = f'mount -t tmpfs -o {options} tmpfs "$1"; shift; "$@"; echo "rc=$?"; ls -A "$LIVLAB_DATA"'
    command = [sys.executable, "-c", code, "data", "add", str(tmp_path / "f.csv"), "--name", "mine", "--source", "s"]
    run = subprocess.run(
        [unshare, "-rm", "sh", "-c", shell, "sh", str(place), *command, "--kind", "assumed", "--unit", "1", "--yes"],
        env={**os.environ, "LIVLAB_DATA": str(place)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.stdout.splitlines()[-1] == "rc=3", run.stdout + run.stderr
    error = " ".join(run.stderr.split())
    assert says in error
    assert "Nothing was changed" in error
    assert "Traceback" not in error
