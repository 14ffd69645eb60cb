"""`livlab run` as a user meets it, in a process of its own: what goes wrong, what is said, and what is left behind."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from fuzz.seeds import user_meta

CONFIG = """\
schema = 1
kind = "spectral"
name = "bad"
readings = ["thesis", "consistent", "measured"]
tissue = { variant = "parenchyma_only" }
wavelengths = { list_nm = [500, 600, 700] }
instrument = { kind = "hyperspectral-camera" }
solver = { kind = "adding-doubling", tolerance = 1e-3 }
[[reference]]
label = "my liver"
dataset = "my_liver"
[[criterion]]
metric = "pearson"
against = "my liver"
reference = 1.0
tolerance = 2.0
"""
TABLE = "wavelength_nm,reflectance\n" + "".join(f"{x},{0.1 + (x - 450) / 1000}\n" for x in range(450, 801, 50))
MAIN = "import sys; from livlab.cli import main; sys.argv[0] = 'livlab'; main()"


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "bad.toml").write_text(CONFIG)
    dataset(tmp_path, TABLE)
    return tmp_path


def dataset(place: Path, table: str, *, hashed: str | None = None) -> None:
    folder = place / "data" / "my_liver"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "table.csv").write_text(table)
    (folder / "meta.toml").write_text(user_meta((table if hashed is None else hashed).encode(), longest_nm=800.0))


def environment(place: Path) -> dict[str, str]:
    return {**os.environ, "LIVLAB_DATA": str(place / "data"), "COLUMNS": "200"}


def livlab(place: Path, *words: str, **options: object) -> subprocess.CompletedProcess[str]:
    report = [] if words[0] != "run" else ["--no-report"]  # drawing the figures is most of such a run's time
    command = [sys.executable, "-c", MAIN, *words, *report]
    return subprocess.run(
        command, cwd=place, env=environment(place), capture_output=True, text=True, timeout=120, check=False, **options
    )  # type: ignore[call-overload,no-any-return]


def said(done: subprocess.CompletedProcess[str], code: int) -> str:
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    assert "error:" in done.stderr
    assert "remedy:" in done.stderr
    return " ".join(done.stderr.split())


@pytest.mark.parametrize(
    ("old", "new", "message", "remedy"),
    [
        ("list_nm = [500,", "list_nm = [100,", "wavelength_nm = 100.0: is outside the range of", "Stay inside"),
        ("list_nm = [500,", "list_nm = [510, 500,", "must rise strictly", "Sort"),
        ('dataset = "my_liver"', 'dataset = "my_livre"', "There is no dataset 'my_livre'", "Did you mean my_liver"),
        ('dataset = "my_liver"', 'dataset = "my_liver"\ncolumn = "r"', "has no column 'r'", "It has: wavelength_nm"),
        ('name = "bad"', 'name = "bad"\nnome = 1', "line 4: nome = 1: unknown key", "Did you mean 'name'?"),
    ],
)  # fmt: skip
def test_bad_input_is_told_before_anything_is_written(
    place: Path, old: str, new: str, message: str, remedy: str
) -> None:
    (place / "bad.toml").write_text(CONFIG.replace(old, new))
    told = said(livlab(place, "run", "bad.toml"), 2)
    assert message in told
    assert remedy in told
    assert not list(place.glob("runs/*"))


def rows(change: str) -> str:
    lines = TABLE.splitlines()
    if change == "unsorted":
        lines[2], lines[3] = lines[3], lines[2]
    elif change == "nan":
        lines[3] = "550,nan"
    elif change == "text":
        lines[3] = "550,high"
    else:
        lines = lines[:1]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("change", "message"), [("unsorted", "must rise"), ("nan", "finite"), ("text", "high"), ("empty", "no rows")]
)
def test_a_bad_reference_curve_is_told(place: Path, change: str, message: str) -> None:
    dataset(place, rows(change))
    assert message in said(livlab(place, "run", "bad.toml"), 2)
    assert not list(place.glob("runs/*"))


def test_a_tampered_dataset_is_told_even_where_the_result_is_there(place: Path) -> None:
    assert livlab(place, "run", "-q", "bad.toml").returncode == 0
    dataset(place, TABLE.replace("0.15", "0.16"), hashed=TABLE)
    told = said(livlab(place, "run", "bad.toml"), 2)
    assert "has been changed" in told
    dataset(place, TABLE.replace("0.15", "0.16"))
    assert livlab(place, "run", "-q", "bad.toml").returncode == 0
    assert len(list(place.glob("runs/bad-*"))) == 2


def test_a_run_that_is_there_is_found_in_an_instant(place: Path) -> None:
    import resource

    assert livlab(place, "run", "-q", "bad.toml").returncode == 0
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = livlab(place, "run", "bad.toml")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert "Done before" in done.stdout
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 1.5
    call = "app(['run', '--no-report', 'bad.toml'], standalone_mode=False)"
    modules = f"import sys; from livlab.cli import app; {call}; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", modules], cwd=place, env=environment(place), capture_output=True, text=True, check=True
    ).stdout.split()
    assert not {"drjit", "mitsuba", "matplotlib", "numba", "miepython", "xarray"} & set(loaded)


def test_a_missing_file_and_a_missing_folder_are_told(place: Path) -> None:
    assert "no such file" in said(livlab(place, "run", "bud.toml"), 2)
    assert "Did you mean 'bad.toml'?" in said(livlab(place, "run", "bud.toml"), 2)
    (place / "file").write_text("")
    told = said(livlab(place, "run", "bad.toml", "--out", "file"), 3)
    assert "Cannot write file" in told
    assert "--out" in told


def test_ctrl_c_keeps_what_is_done_and_the_next_call_goes_on(place: Path) -> None:
    (place / "bad.toml").write_text(
        CONFIG.replace("[500, 600, 700]", str(list(range(500, 720, 10)))).replace("1e-3", "1e-6")
    )
    process = subprocess.Popen(
        [sys.executable, "-c", MAIN, "run", "--no-report", "bad.toml"],
        cwd=place, env=environment(place), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stderr is not None
    first = process.stderr.readline()
    assert first.startswith("thesis: 0%"), first
    process.send_signal(signal.SIGINT)
    _, rest = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "Stopping when this batch is saved" in rest
    assert "To go on: livlab run bad.toml" in " ".join(rest.split())
    (folder,) = place.glob("runs/bad-*")
    assert [x.name.split("-")[0] for x in folder.glob(".pieces/*.nc")] == ["measure_thesis"]
    assert not (folder / "claims.csv").exists()
    again = livlab(place, "run", "bad.toml")
    assert again.returncode == 0
    assert "thesis: 100%, 0.0 s (as saved)" in again.stderr
    assert "consistent: 0%" in again.stderr
    assert not (folder / ".pieces").exists()


@pytest.mark.slow
def test_a_killed_run_goes_on(place: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", MAIN, "run", "--no-report", "bad.toml"],
        cwd=place, env=environment(place), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("consistent: 0%"):
            break
    process.kill()
    process.communicate()
    again = livlab(place, "run", "bad.toml")
    assert again.returncode == 0, again.stderr
    assert "thesis: 100%, 0.0 s (as saved)" in again.stderr


@pytest.mark.slow
def test_two_processes_on_one_folder_do_not_mix(place: Path) -> None:
    both = [
        subprocess.Popen(
            [sys.executable, "-c", MAIN, "run", "-q", "--no-report", "bad.toml"],
            cwd=place, env=environment(place), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )
        for _ in range(2)
    ]  # fmt: skip
    ends = [process.communicate(timeout=120) for process in both]
    codes = sorted(process.returncode for process in both)
    assert codes in ([0, 0], [0, 3])
    for process, (_, err) in zip(both, ends, strict=True):
        assert process.returncode == 0 or "Another process" in err
    assert livlab(place, "run", "bad.toml").stdout.count("Done before") == 1


needs_mount = pytest.mark.skipif(
    not (sys.platform == "linux" and os.geteuid() == 0 and shutil.which("mount")),
    reason="mounting a small file system needs root on Linux",
)


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 24 MiB."""
    where = tmp_path / "disk"
    where.mkdir()
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=24m", "tmpfs", str(where)], capture_output=True, text=True, check=False
    )
    if made.returncode:
        pytest.skip(f"cannot mount: {made.stderr.strip()}")
    yield where
    for _ in range(20):
        if not subprocess.run(["umount", str(where)], capture_output=True, check=False).returncode:
            break
        time.sleep(0.1)


@needs_mount
def test_a_disk_without_room_is_told_before_the_work(place: Path, disk: Path) -> None:
    (disk / "ballast").write_bytes(b"\0" * (20 << 20))
    told = said(livlab(place, "run", "bad.toml", "--out", str(disk / "runs")), 3)
    assert "MiB free" in told
    assert "Free some space" in told
    assert not list(disk.rglob("*.nc"))


FILL = """
import sys
from pathlib import Path
from livlab.runs import work as runs_work

ballast, out = Path(sys.argv[1]), sys.argv[2]
real = runs_work.Run.write_result

def fill(self, groups):
    with ballast.open("wb", buffering=0) as stream:
        try:
            while stream.write(bytes(4096)):
                pass
        except OSError:
            pass
    real(self, groups)

runs_work.Run.write_result = fill
from livlab.cli import main
sys.argv = ["livlab", "run", "bad.toml", "--out", out, "--no-report"]
main()
"""


@needs_mount
@pytest.mark.slow
def test_a_disk_that_fills_up_leaves_nothing_half_written_and_the_run_goes_on(place: Path, disk: Path) -> None:
    ballast, runs = disk / "ballast", disk / "runs"
    done = subprocess.run(
        [sys.executable, "-c", FILL, str(ballast), str(runs)],
        cwd=place, env=environment(place), capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    told = said(done, 3)
    assert "No space left on device" in told
    assert "result.nc" in told
    assert "Free some space" in told
    (folder,) = runs.iterdir()
    assert not (folder / "result.nc").exists()
    assert not [x for x in folder.rglob(".*") if ".tmp" in x.name]
    ballast.unlink()
    again = livlab(place, "run", "bad.toml", "--out", str(runs))
    assert again.returncode == 0, again.stderr
    assert again.stderr.count("as saved") == 3


@needs_mount
def test_a_read_only_disk_is_told(place: Path, disk: Path) -> None:
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
    told = said(livlab(place, "run", "bad.toml", "--out", str(disk / "runs")), 3)
    assert "Read-only file system" in told
    assert "--out" in told


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_run_folder_is_told(place: Path) -> None:
    (place / "runs").mkdir(mode=0o500)
    try:
        assert "Permission denied" in said(livlab(place, "run", "bad.toml"), 3)
    finally:
        (place / "runs").chmod(0o700)
