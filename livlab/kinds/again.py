"""A run from its manifest alone, and what is different where it does not come out the same."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from livlab.config.load import parse_experiment
from livlab.config.schema import Experiment
from livlab.core import markup
from livlab.errors import DatasetError, InputError, LivlabError
from livlab.kinds.again_files import compared_files
from livlab.kinds.execute import execute
from livlab.runs.compare import FileVerdict
from livlab.runs.files import plain_file, sha256, write_whole
from livlab.runs.identity import RESULT_VERSION, digest, machine, read_manifest
from livlab.runs.work import Progress

LARGEST_BYTES = 64 << 20
"""A manifest has some kilobytes; a larger file is none."""

NAMED = (
    "livlab", "code", "result_version", "python", "platform", "machine", "processor", "cores", "libllvm", "variant",
    "gpu", "solvers",
)  # fmt: skip
"""Entries of a manifest that can make numbers differ, beside packages and datasets."""


@dataclass(frozen=True)
class Difference:
    """Something that is not as it was: a version, a dataset, the machine."""

    what: str
    then: str
    now: str

    def __str__(self) -> str:
        return f"{self.what}: {self.then} then, {self.now} now"


@dataclass(frozen=True)
class Original:
    """A finished run as its manifest tells it.

    Attributes
    ----------
    manifest
        The manifest.
    experiment
        The experiment it holds.
    folder
        The run folder; only the manifest need be in it.
    """

    manifest: dict[str, Any]
    experiment: Experiment
    folder: Path

    @property
    def name(self) -> str:
        """Name of the experiment."""
        return str(self.manifest.get("name", self.folder.name))


@dataclass(frozen=True, repr=False)
class Again:
    """A run done again.

    Attributes
    ----------
    original
        The first one.
    folder
        Where the second one is.
    differences
        What is not as it was, whether or not it moved a number.
    files
        Each file of the result.
    changed
        Files of the first folder that were changed or lost after the run: what they say is not what the run wrote.
    """

    original: Original
    folder: Path
    differences: tuple[Difference, ...]
    files: tuple[FileVerdict, ...]
    changed: tuple[str, ...] = ()

    @property
    def same(self) -> bool:
        """Whether every file holds the same result."""
        return all(file.same for file in self.files)

    def __bool__(self) -> bool:
        return self.same

    def __repr__(self) -> str:
        told = "the same" if self.same else f"differs in {', '.join(f.name for f in self.files if not f.same)}"
        return f"<Again {self.original.name!r}: {told}, {len(self.differences)} differences around it>"

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return markup.card(
            f"{self.original.name}, again",
            ("the results are the same" if self.same else "the results differ")
            + (f"; changed since the run: {', '.join(self.changed)}" if self.changed else ""),
            markup.table(
                ["file", "result", "where, and by how much"], [(f.name, f.verdict, f.detail) for f in self.files]
            ),
            markup.table(["not as it was", "then", "now"], [(d.what, d.then, d.now) for d in self.differences]),
        )


def read_original(path: Path) -> Original:
    """A run by its folder or its manifest.

    Raises
    ------
    InputError
        There is no manifest, it is cut off or no manifest, the run did not finish, or it holds no experiment and the
        folder's config.toml is not the one of the run.
    """
    file = path / "manifest.json" if path.is_dir() else path
    remedy = "Name a run folder that `livlab run` made, or its manifest.json."
    try:
        if file.stat().st_size > LARGEST_BYTES:
            raise InputError.of("run", str(file), "is no manifest: it is too large", remedy)
        manifest = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError.of("run", str(path), "has no manifest.json", remedy) from None
    except (OSError, RecursionError) as error:
        raise InputError.of("run", str(file), f"cannot be read ({error})", remedy) from None
    except ValueError as error:
        mend = f"Bring the file back, or run the experiment itself: livlab run {file.parent / 'config.toml'}"
        raise InputError.of("run", str(file), f"is cut off or damaged ({error})", mend) from None
    wrong = _wrong(manifest)
    if wrong:
        raise InputError.of("run", str(file), f"is no manifest: it lacks {', '.join(wrong)}", remedy)
    if manifest.get("status") != "complete":
        raise InputError.of(
            "run", str(path), "did not finish, so there is nothing to compare with",
            f"Finish it: {manifest.get('command') or 'livlab run'}",
        )  # fmt: skip
    return Original(manifest, _experiment(file, manifest), file.parent)


def differences_now(original: Original) -> tuple[Difference, ...]:
    """What is not as it was, as far as it can be told before the run: versions, machine, datasets, the experiment."""
    then = original.manifest
    now = {**machine(), "livlab": _own_version(), "result_version": RESULT_VERSION}
    # Only the run itself knows what walked.
    told = {k: v for k, v in now.items() if k in then and k not in ("libllvm", "variant", "gpu")}
    found = _changed(then, told)
    found += _datasets(then["datasets"], original.experiment)
    as_then = digest(original.experiment, then["datasets"], then.get("result_version", 0))
    if as_then != then["digest"]:
        found.append(Difference("experiment", f"digest {then['digest'][:12]}", f"read as {as_then[:12]}"))
    return tuple(found)


def run_again(
    original: Original, base: Path | None = None, *, progress: Progress | None = None, report: bool = True
) -> Again:
    """Do a run again from its manifest, into a new folder, and compare every file of the result.

    Parameters
    ----------
    original
        As `read_original` gives it.
    base
        Folder for the new run folder; `reruns` beside the run if not said.
    progress
        Who watches.
    report
        Whether to build the report.

    Returns
    -------
    The comparison, which is also written to rerun.json in the new folder.

    Raises
    ------
    InputError
        `base` would put the new run in place of the old one.
    DatasetError
        A dataset is gone or was tampered with: the message names what else differs.
    EnvironmentProblem, LivlabError
        As `livlab.kinds.execute.execute`.
    """
    base = original.folder.resolve().parent / "reruns" if base is None else base
    if base.resolve() == original.folder.resolve().parent:
        raise InputError.of("out", str(base), "holds the run itself", "Name another folder; nothing is overwritten.")
    before = differences_now(original)
    try:
        outcome = execute(
            original.experiment,
            base=base,
            force=True,
            command=f"livlab rerun {original.folder}",
            progress=progress,
            report=report,
        )
    except DatasetError as error:
        listed = "; ".join(map(str, before))
        raise DatasetError(
            f"{original.name} cannot be rebuilt: {error.message}" + (f" What differs: {listed}." if listed else ""),
            remedy=_wanted(original) or error.remedy,
        ) from error
    made = read_manifest(outcome.folder)
    then = original.manifest
    late: dict[str, Any] = {k: made.get(k) for k in ("libllvm", "variant", "gpu", "solvers") if k in then}
    differences = (*before, *_changed(then, late))
    files = compared_files(then, original.folder, outcome.folder, made["files"])
    again = Again(original, outcome.folder, differences, files, changed_since(original))
    write_whole(outcome.folder / "rerun.json", json.dumps(as_record(again), indent=2, ensure_ascii=False) + "\n")
    return again


def changed_since(original: Original) -> tuple[str, ...]:
    """Files of the original's folder that are not as its manifest says: edited, damaged or taken away since.

    Nothing is said of a manifest that lies alone.
    """
    known = {name: sha for name, sha in original.manifest["files"].items() if name != "manifest.json"}
    if not any((original.folder / name).exists() for name in known):
        return ()
    return tuple(
        name
        for name, sha in known.items()
        if not plain_file(original.folder, name) or sha256(original.folder / name) != sha
    )


def _wanted(original: Original) -> str:
    """What to ask the run's authors for: datasets that are not here as they were then."""
    from livlab import datasets

    then = original.manifest["datasets"]
    gone = []
    for name in original.experiment.datasets():
        try:
            found = datasets.load(name).meta.sha256
        except datasets.ReferenceUnavailable:
            continue
        except LivlabError:
            found = ""
        if found != then.get(name, found):
            gone.append(f"{name} (SHA-256 of its table.csv: {then[name]})")
    if not gone:
        return ""
    root = datasets.user_root() or "the folder that LIVLAB_DATA names"
    return (
        f"Ask the authors of the run for the folder of {'; '.join(gone)}, with table.csv and meta.toml in it, "
        f"and put it into {root}."
    )


def as_record(again: Again) -> dict[str, Any]:
    """The comparison as plain data."""
    return {
        "original": str(again.original.folder),
        "folder": str(again.folder),
        "same": again.same,
        "changed": list(again.changed),
        "differences": [{"what": d.what, "then": d.then, "now": d.now} for d in again.differences],
        "files": [{"name": f.name, "verdict": f.verdict, "detail": f.detail} for f in again.files],
    }


def _wrong(manifest: Any) -> list[str]:
    """Entries that are not what a manifest has; names of files that lead out of the folder are none."""
    tables = ("datasets", "files", "packages")
    if not isinstance(manifest, dict):
        return ["digest", *tables]
    found = [] if isinstance(manifest.get("digest"), str) else ["digest"]
    for key in (*tables, *(["results"] if "results" in manifest else [])):
        table = manifest.get(key)
        good = isinstance(table, dict) and all(isinstance(v, str) for v in table.values())
        if not good or not all(_inside(name) for name in table or ()):
            found.append(key)
    return found if isinstance(manifest.get("result_version", 0), int) else [*found, "result_version"]


def _inside(name: str) -> bool:
    return not PurePosixPath(name).is_absolute() and ".." not in PurePosixPath(name).parts and "\0" not in name


def _experiment(file: Path, manifest: Mapping[str, Any]) -> Experiment:
    text = manifest.get("experiment")
    if isinstance(text, str):
        return parse_experiment(text, source=f"{file}, experiment").resolve()
    config = file.parent / "config.toml"
    # A manifest of an older livlab: the experiment lies beside it, sealed by its hash.
    if not config.is_file():
        raise InputError.of("run", str(file), "holds no experiment, and has no config.toml beside it", "Bring it back.")
    if sha256(config) != manifest["files"].get("config.toml"):
        raise InputError.of("run", str(config), "is not the one of the run: its hash differs", "Bring it back.")
    return parse_experiment(config.read_text(encoding="utf-8"), source=str(config)).resolve()


def _changed(then: Mapping[str, Any], now: Mapping[str, Any]) -> list[Difference]:
    found = [
        Difference(key.replace("_", " "), _shown(then.get(key)), _shown(now[key]))
        for key in NAMED
        if key in now and then.get(key) != now[key]
    ]
    if "packages" in now:
        had, has = then["packages"], now["packages"]
        found += [
            Difference(name, _shown(had.get(name)), _shown(has.get(name)))
            for name in sorted(had.keys() | has.keys())
            if had.get(name) != has.get(name)
        ]
    return found


def _datasets(then: Mapping[str, str], experiment: Experiment) -> list[Difference]:
    from livlab import datasets

    found = []
    for name in sorted({*then, *experiment.datasets()}):
        try:
            own = datasets.load(name).meta.sha256[:12]
        except datasets.ReferenceUnavailable:
            own = "not available"
        except LivlabError:
            own = "missing or changed"
        had = then.get(name)
        if (had or "")[:12] != own:
            found.append(Difference(f"dataset {name}", had[:12] if had else "not there", own))
    return found


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k} {v}" for k, v in value.items()) or "none"
    return "none" if value in (None, "") else str(value)


def _own_version() -> str:
    from livlab.machine.version import __version__

    return __version__


__all__ = [
    "Again",
    "Difference",
    "Original",
    "as_record",
    "changed_since",
    "differences_now",
    "read_original",
    "run_again",
]
