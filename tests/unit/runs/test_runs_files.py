"""Files are whole or not there; one process a folder."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from livlab.core import files
from livlab.core.files import missing_folder
from livlab.errors import EnvironmentProblem
from livlab.runs import files as runs_files
from livlab.runs.files import csv_text, locked, open_folder, read_csv, write_whole

AS_ROOT = hasattr(os, "geteuid") and os.geteuid() == 0


def test_a_file_replaces_the_old_one_and_leaves_no_other(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    write_whole(target, "old")
    write_whole(target, "new")
    assert target.read_text() == "new"
    assert [x.name for x in tmp_path.iterdir()] == ["a.txt"]


def test_a_write_that_fails_leaves_the_old_file_and_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "a.txt"
    write_whole(target, "old")

    def full(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(runs_files.os, "fsync", full)
    with pytest.raises(EnvironmentProblem, match="No space left") as caught:
        write_whole(target, "new")
    assert "--out" in caught.value.remedy
    assert target.read_text() == "old"
    assert [x.name for x in tmp_path.iterdir()] == ["a.txt"]


def test_a_folder_under_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("I am a file")
    with pytest.raises(EnvironmentProblem, match="Cannot write"):
        open_folder(tmp_path / "runs" / "x")


@pytest.mark.skipif(AS_ROOT, reason="root may write anywhere")
def test_a_forbidden_folder_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(EnvironmentProblem, match="Permission denied"):
            open_folder(tmp_path / "x")
    finally:
        tmp_path.chmod(0o700)


def test_a_nearly_full_disk_is_refused_before_the_work(tmp_path: Path) -> None:
    with pytest.raises(EnvironmentProblem, match="MiB free") as caught:
        open_folder(tmp_path, space=1 << 62)
    assert "Free some space" in caught.value.remedy


def test_a_second_process_is_refused_and_told_who_holds_the_folder(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from livlab.errors import EnvironmentProblem\n"
        "from livlab.runs.files import locked\n"
        "try:\n  with locked(Path(sys.argv[1])): print('held')\n"
        "except EnvironmentProblem as e: print(e.message)"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]
    with locked(tmp_path):
        inside = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        assert f"Another process ({os.getpid()})" in inside
    after = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert after.strip() == "held"


def test_the_lock_of_a_killed_process_is_free_and_its_half_files_go(tmp_path: Path) -> None:
    code = (
        "import sys, os; from pathlib import Path; from livlab.runs.files import locked\n"
        "folder = Path(sys.argv[1])\n"
        "with locked(folder):\n"
        "    (folder / '.result.nc.1.tmp').write_text('half')\n"
        "    print('held', flush=True); os.kill(os.getpid(), 9)"
    )
    killed = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=False)
    assert killed.returncode == -9
    assert killed.stdout.strip() == "held"
    assert (tmp_path / ".result.nc.1.tmp").exists()
    with locked(tmp_path):
        assert [x.name for x in tmp_path.iterdir()] == [".lock"]


def test_a_table_with_an_unknown_column_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(KeyError, match="no column"):
        csv_text(["a"], [{"a": 1, "b": 2}])
    write_whole(tmp_path / "t.csv", csv_text(["a", "b"], [{"a": 'x,"y"\nz', "b": 1 / 3}]))
    assert read_csv(tmp_path / "t.csv") == [{"a": 'x,"y"\nz', "b": "0.333333333"}]


def test_a_missing_folder_is_to_be_made_where_it_can_be_and_only_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there = tmp_path / "not yet" / "made"
    with pytest.raises(EnvironmentProblem) as caught:
        write_whole(there / "a.txt", "x")
    assert f"mkdir -p '{there}'" in caught.value.remedy
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").write_text("")
    assert "is a file" in missing_folder(tmp_path / "file" / "deeper")

    def refused(*_args: object, **_options: object) -> None:
        raise OSError(errno.ENOENT, os.strerror(errno.ENOENT))

    monkeypatch.setattr(files.tempfile, "mkdtemp", refused)  # as a kernel's own file system answers
    assert missing_folder(there) == f"Nothing can be written in {tmp_path}: choose another folder."


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="there is no /proc here")
def test_where_no_folder_can_be_made_none_is_asked_for() -> None:
    assert missing_folder(Path("/proc/none/at all")) == "Nothing can be written in /proc: choose another folder."
    with pytest.raises(EnvironmentProblem, match="Cannot write") as caught:
        write_whole(Path("/proc/livlab.txt"), "x")
    assert "Make the folder" not in caught.value.remedy
