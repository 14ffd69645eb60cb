"""The dossier's work: every experiment run or found done, one that fails not stopping the others, and what came out.

How an experiment is run is the caller's (a process of its own, in the command line). What came out is a record, from
which alone, with the run folders, the site is built.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from livlab.config.errors import nearest
from livlab.config.load import load_experiment
from livlab.config.schema import Experiment
from livlab.dossier.config import Dossier
from livlab.errors import ConfigError, EnvironmentProblem, Interrupted, LivlabError
from livlab.machine.version import __version__

REST = "rest"
"""Group of experiments that the dossier's file does not list."""

RECORD_SCHEMA = 1

State = Literal["complete", "failed", "left out"]


@dataclass(frozen=True)
class Planned:
    """An experiment to run: its name and file, its group, and the experiment or why it cannot be read."""

    name: str
    path: Path
    group: str
    config: Experiment | None
    trouble: str = ""

    @property
    def title(self) -> str:
        """What people call it."""
        return (self.config.title if self.config else "") or self.name


@dataclass(frozen=True)
class Ended:
    """How an experiment ended.

    Attributes
    ----------
    state, reason
        Complete, failed or left out; and why, where it is not complete.
    folder
        Its run folder, where there is one.
    seconds, processor_seconds
        By the clock and of all cores, in this call; 0 for one found done.
    cached
        Whether it was done before.
    """

    state: State
    reason: str = ""
    folder: Path | None = None
    seconds: float = 0.0
    processor_seconds: float = 0.0
    cached: bool = False


Runner = Callable[[Planned], Ended]
Say = Callable[[str], None]


def planned(dossier: Dossier, file: Path, only: Sequence[str] = ()) -> list[Planned]:
    """Every experiment of the dossier's folder: those listed in their order, then the others by name.

    Raises
    ------
    ConfigError
        The folder is missing, or `only` names an experiment that is not there.
    """
    folder = (file.parent / dossier.folder).resolve()
    there = {p.stem: p for p in sorted(folder.glob("*.toml"))} if folder.is_dir() else {}
    if not there:
        raise ConfigError(f"{folder} holds no experiment.", remedy=f"Mend `folder` in {file}.")
    listed = {e.name: g.id for g in dossier.group for e in g.experiment}
    names = [*listed, *(n for n in there if n not in listed)]
    for name in only:
        if name not in names:
            raise ConfigError(
                f"--only {name}: no such experiment.", remedy=nearest(name, names) or f"There are: {', '.join(names)}."
            )
    return [_read(n, there.get(n, folder / f"{n}.toml"), listed.get(n, REST)) for n in names]


def found(config: Experiment, base: Path) -> Path | None:
    """The folder of this very experiment's finished run, or None."""
    from livlab.runs.identity import dataset_hashes, digest, folder_of, is_complete

    resolved = config.resolve()
    identity = digest(resolved, dataset_hashes(resolved.datasets()))
    folder = folder_of(resolved, identity, base)
    return folder if is_complete(folder, identity) else None


def validate(
    experiments: Sequence[Planned],
    run: Runner,
    base: Path,
    *,
    only: Sequence[str] = (),
    expected: dict[str, float] | None = None,
    say: Say = lambda _: None,
) -> dict[str, Ended]:
    """Run what is not done; whatever one experiment does, the next is tried.

    Parameters
    ----------
    run
        Runs one experiment that is not done.
    only
        Names to run; the others are found if they are done.
    expected
        Seconds that each is known to take, for the time left.
    say
        Hears one line an experiment.

    Raises
    ------
    Interrupted
        The user stopped it; what is done is kept.
    """
    ended: dict[str, Ended] = {}
    todo: list[Planned] = []
    for one in experiments:
        done = _looked_up(one, base)
        if done is None and only and one.name not in only:
            done = Ended("left out", "not run: left out by --only")
        if done is None:
            todo.append(one)
        else:
            ended[one.name] = done
    kept = sum(e.cached for e in ended.values())
    say(f"{len(experiments)} experiments: {kept} done before, {len(todo)} to run.")
    for k, one in enumerate(todo):
        known = [(expected or {}).get(x.name) for x in todo[k:]]
        say(f"[{k + 1}/{len(todo)}] {one.name}: {one.title}" + _left(known))
        started = time.monotonic()
        try:
            ended[one.name] = run(one)
        except (Interrupted, KeyboardInterrupt):
            raise
        except LivlabError as error:
            seconds = time.monotonic() - started
            ended[one.name] = Ended("failed", f"{error.message} {error.remedy}".strip(), None, seconds)
        told = ended[one.name]
        cores = f", {told.processor_seconds:.0f} s of all cores" if told.processor_seconds else ""
        say(f"    {told.state} after {told.seconds:.0f} s{cores}" + (f": {told.reason}" if told.reason else ""))
    return {one.name: ended[one.name] for one in experiments}


def record(
    dossier: Dossier,
    experiments: Sequence[Planned],
    ended: dict[str, Ended],
    baseline: dict[str, Any],
    out: Path,
    *,
    family: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """What the site is built from, as JSON takes it; folders are told from the site's own.

    Parameters
    ----------
    dossier, experiments, ended, baseline
        What was asked for, what came out, and how it compares.
    out
        The site's folder.
    family
        How sure the verdicts are together (`livlab.dossier.sure.family_record`).
    """
    rows = []
    for one in experiments:
        e = ended[one.name]
        rows.append(
            {
                "name": one.name,
                "title": one.title,
                "group": one.group,
                "kind": "" if one.config is None else str(one.config.plain().get("kind", "")),
                "description": "" if one.config is None else one.config.description,
                "state": e.state,
                "reason": e.reason,
                "folder": None if e.folder is None else os.path.relpath(e.folder, out),
                "seconds": round(e.seconds, 2),
                "processor_seconds": round(e.processor_seconds, 2),
                "cached": e.cached,
            }
        )
    return {
        "schema": RECORD_SCHEMA,
        "livlab": __version__,
        "made": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "dossier": dossier.model_dump(mode="json", by_alias=True),
        "experiments": rows,
        "baseline": baseline,
        "family": {} if family is None else dict(family),
    }


def _read(name: str, path: Path, group: str) -> Planned:
    try:
        config = load_experiment(path)
    except LivlabError as error:
        return Planned(name, path, group, None, f"{error.message} {error.remedy}".strip())
    trouble = "" if config.name == name else f"{path.name} calls itself {config.name!r}: give it its file's name."
    return Planned(name, path, group, None if trouble else config, trouble)


def _looked_up(one: Planned, base: Path) -> Ended | None:
    """How it ended if that needs no run: done before, or not to be run at all."""
    from livlab.kinds.report import rebuild_report

    if one.config is None:
        return Ended("failed", one.trouble)
    try:
        folder = found(one.config, base)
        if folder is None:
            return None
        if not (folder / "report.html").is_file():
            rebuild_report(folder)
    except EnvironmentProblem:
        raise
    except LivlabError as error:
        return Ended("failed", f"{error.message} {error.remedy}".strip())
    return Ended("complete", folder=folder, cached=True)


def _left(known: Sequence[float | None]) -> str:
    """How long this one and all of them take, as far as that is known.

    >>> _left([30.0, 90.0]), _left([None, 90.0]), _left([None])
    ('; about 30 s of 2 min left', '; of 2 min left and more', '')
    """
    sure = [s for s in known if s is not None]
    if not sure:
        return ""
    more = " left" if len(sure) == len(known) else " left and more"
    own = f" about {_spell(known[0])}" if known[0] is not None else ""
    return f";{own} of {_spell(sum(sure))}{more}"


def _spell(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
