"""What is fuzzed: for each reader the files it takes, and the call that a user's command makes with them."""

from __future__ import annotations

import contextlib
import os
import resource
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from fuzz.brdf_seeds import DEAR
from livlab.brdf.files.registry import FORMATS
from livlab.errors import LivlabError

SECONDS = 10
"""A reader that takes more of a processor's time over a file of at most `LONGEST` bytes hangs."""

WAIT = 120
"""A reader that has not come back after so many seconds of the clock waits for something; a busy machine does not."""

LONGEST = 1 << 16
"""Bytes of an input."""

MEMORY = 2 << 30
"""Bytes that a reader may take beyond what the process has, whatever a file's header claims."""

Reader = Callable[[Path], object]


@dataclass(frozen=True)
class Target:
    """A reader.

    Attributes
    ----------
    name
        How the command line calls it.
    files
        Names that the input is written under; the reader's kind goes by them. More than one: the input's first byte
        picks which file of a folder it becomes, the others keep the seed's content. None: every text file there is.
    read
        The call.
    traced
        Modules whose branches guide the search, beside livlab's.
    cost
        About how many times the milliseconds that a cheap reader takes: it gets so many fewer inputs.
    folder
        Whether the reader gets the folder and not the file.
    """

    name: str
    files: tuple[str, ...]
    read: Reader
    traced: tuple[str, ...] = ()
    cost: int = 1
    folder: bool = False


class TooSlow(BaseException):
    """A reader took longer than `SECONDS`; no reader may catch it as an error of the file."""


class TooMuch(AssertionError):
    """A reader wanted more memory than `MEMORY`, and took the refusal for a damaged file."""


def attempt(target: Target, content: bytes, place: Path, seed: Path) -> str:
    """Hand one input to a reader.

    Returns
    -------
    "read", or the error's message where it was refused as it should be. What is raised is a finding.

    Raises
    ------
    AssertionError
        An error without message or remedy.
    TooSlow, TooMuch
        See there.
    Exception
        Whatever came out of the reader that is no error of livlab's.
    """
    names = names_in(target, seed)
    name = names[0]
    if len(names) > 1:
        name, content = names[(content[0] if content else 0) % len(names)], content[1:]
    file = place / name
    if target.folder and not place.exists():
        shutil.copytree(seed, place)
    place.mkdir(exist_ok=True)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(content)
    try:
        with _watched():
            target.read(place if target.folder else file)
    except LivlabError as error:
        assert error.message, f"{type(error).__name__} without a message"
        assert error.remedy, f"without a remedy: {error.message}"
        if "MemoryError" in error.message or "Unable to allocate" in error.message:
            raise TooMuch(error.message) from error
        return error.message
    finally:
        if target.folder:
            with contextlib.suppress(OSError):
                shutil.copy(seed / name, file) if (seed / name).exists() else file.unlink()
    return "read"


def names_in(target: Target, seed: Path) -> tuple[str, ...]:
    """Files of a folder that an input can become: those that the target names, or every text file that is there."""
    return target.files or tuple(
        sorted(
            x.relative_to(seed).as_posix()
            for x in seed.rglob("*")
            if x.suffix in (".csv", ".json", ".toml") and not x.name.startswith(".")
        )
    )


@contextlib.contextmanager
def bounded(more: int = MEMORY) -> Iterator[None]:
    """Keep this process from taking more than `more` bytes of addresses beyond those that it has."""
    if not sys.platform.startswith("linux"):
        yield
        return
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * os.sysconf("SC_PAGE_SIZE") + more, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


@contextlib.contextmanager
def _watched() -> Iterator[None]:
    def late(number: int, _frame: FrameType | None) -> None:
        raise TooSlow(f"more than {WAIT} s" if number == signal.SIGALRM else f"more than {SECONDS} s of computing")

    timers = ((signal.SIGALRM, signal.ITIMER_REAL, WAIT), (signal.SIGPROF, signal.ITIMER_PROF, SECONDS))
    old = [signal.signal(number, late) for number, _, _ in timers]
    for _, timer, seconds in timers:
        signal.setitimer(timer, seconds)
    try:
        yield
    finally:
        for (number, timer, _), handler in zip(timers, old, strict=True):
            signal.setitimer(timer, 0)
            signal.signal(number, handler)


def _experiment(path: Path) -> None:
    from livlab.config import load_experiment, to_toml
    from livlab.runs.identity import canonical

    config = load_experiment(path).resolve()
    canonical(config)
    to_toml(config)


def _rig(path: Path) -> None:
    from livlab.acquire.photographs.rig_file import read_rig_file

    read_rig_file(path)


def _preset(path: Path) -> None:
    from livlab.model.tissue.presets import read_preset

    preset = read_preset(path)
    for state in list(preset.states)[:4]:
        preset.build(state)


def _spectrum(path: Path) -> None:
    from livlab.datasets.draft import read_draft

    read_draft(path)


def _dataset(folder: Path) -> None:
    from livlab.datasets.catalogue import read_folder

    read_folder(folder)


def _profile(path: Path) -> None:
    from livlab.acquire.micrographs.table import read_profile

    read_profile(path)


def _micrograph(path: Path) -> None:
    from livlab.acquire.micrographs.files import read_pages

    for _ in read_pages(path):
        pass


def _brdf(path: Path) -> None:
    import numpy as np
    import xarray as xr

    from livlab.brdf.files.registry import format_to_read

    found = format_to_read(path).functions().read(path)
    if not isinstance(found, xr.Dataset):  # a function: at two directions, since a table of it takes its time
        way = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])
        assert found.evaluate(way, way).shape == (2, len(found.channels))
        assert isinstance(found.source, str)


def _mesh(path: Path) -> None:
    from livlab.model.shapes import check, read_mesh

    check(read_mesh(path))


def _volume(path: Path) -> None:
    from livlab.model.shapes import read_volume

    read_volume(path, label=1, spacing_mm=(1.0,) if path.suffix == ".npy" else None)


def _slices(folder: Path) -> None:
    from livlab.model.shapes import read_volume

    read_volume(folder, spacing_mm=(1.0,))


def _photograph(path: Path) -> None:
    from livlab.acquire.photographs.read import read_photograph

    read_photograph(path)


def _photographs(folder: Path) -> None:
    from livlab.acquire.photographs.diligent import load_folder

    load_folder(folder)


def _ledger(path: Path) -> None:
    from livlab.model.transport.ledger.record_ledger import load

    load(path)


def _run(folder: Path) -> None:
    from livlab.reports.folder import read_run
    from livlab.runs.identity import is_complete, read_manifest

    read_manifest(folder)
    is_complete(folder)
    read_run(folder)


def _report(folder: Path) -> None:
    from livlab.kinds.report import build_report

    build_report(folder)


def _gallery(folder: Path) -> None:
    from livlab.kinds.picture.gallery import build_gallery

    build_gallery([folder / "run"], folder / "gallery")


def _bench(folder: Path) -> None:
    from livlab.reports.bench import read_bench, write_bench

    found = read_bench(folder)
    if found is not None:
        write_bench(found, folder / "page.html")


def _claims(path: Path) -> None:
    from livlab.criteria import read_claims

    read_claims(path)


TARGETS = {
    t.name: t
    for t in (
        Target("experiment", ("x.toml",), _experiment, ("tomllib",)),
        Target("rig", ("rig.toml",), _rig, ("tomllib",)),
        Target("preset", ("x.toml",), _preset, ("tomllib",)),
        Target("spectrum", ("x.csv",), _spectrum),
        Target("dataset", ("meta.toml", "table.csv"), _dataset, ("tomllib",), folder=True),
        Target("profile-csv", ("x.csv",), _profile),
        Target("profile-toml", ("x.toml",), _profile, ("tomllib",)),
        Target("micrograph-png", ("x.png",), _micrograph, ("PIL",)),
        Target("micrograph-tiff", ("x.tif",), _micrograph, ("tifffile",)),
        *(
            Target(f"brdf-{name}", (f"x{row.suffixes[0]}",), _brdf, cost=DEAR.get(name, 1))
            for name, row in FORMATS.items()
        ),
        Target("mesh-ply", ("x.ply",), _mesh, ("trimesh.exchange.ply",), cost=10),
        Target("mesh-obj", ("x.obj",), _mesh, ("trimesh.exchange.obj",), cost=10),
        Target("mesh-stl", ("x.stl",), _mesh, ("trimesh.exchange.stl",), cost=10),
        Target("volume-nifti", ("x.nii",), _volume, ("nibabel",)),
        Target("volume-nifti-gz", ("x.nii.gz",), _volume, ("nibabel",)),
        Target("volume-nrrd", ("x.nrrd",), _volume, ("nrrd",)),
        Target("volume-npy", ("x.npy",), _volume),
        Target("volume-npz", ("x.npz",), _volume, ("zipfile",)),
        Target("volume-slices", ("0.png", "1.tif"), _slices, ("PIL", "tifffile"), folder=True),
        Target("photograph-png", ("x.png",), _photograph, ("PIL",)),
        Target("photograph-tiff", ("x.tif",), _photograph, ("tifffile",)),
        Target("photograph-exr", ("x.exr",), _photograph, cost=10),
        Target("photograph-dng", ("x.dng",), _photograph, cost=10),
        Target("photograph-other", ("x.jpg",), _photograph, ("PIL",)),
        Target(
            "photographs",
            ("filenames.txt", "light_directions.txt", "light_intensities.txt", "mask.png"),
            _photographs,
            cost=10,
            folder=True,
        ),
        Target("ledger", ("x.nc",), _ledger, cost=10),
        Target("run", (), _run, ("tomllib",), cost=10, folder=True),
        Target("run-netcdf", ("result.nc",), _run, cost=10, folder=True),
        Target("run-report", (), _report, cost=100, folder=True),
        Target("run-picture", (), _report, cost=100, folder=True),
        Target("run-optics", (), _report, cost=100, folder=True),
        Target("gallery", (), _gallery, cost=10, folder=True),
        Target("bench", ("bench.json",), _bench, folder=True),
        Target("claims", ("claims.csv",), _claims),
    )
}
"""Every reader by name."""
