"""The baseline: which claims held when it was last recorded, and what has changed since."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from livlab.core.files import write_whole
from livlab.dossier.config import Unrecorded
from livlab.dossier.sure import claims_of
from livlab.dossier.validate import Ended
from livlab.errors import ConfigError
from livlab.machine.version import __version__

SCHEMA = 1


@dataclass(frozen=True)
class Change:
    """A claim that held and does not, or the other way round."""

    experiment: str
    claim: str
    verdict: str
    why: str = ""


@dataclass(frozen=True)
class Baseline:
    """What held: claims by experiment, and how long each took; `file` is "" where there is none yet."""

    holds: Mapping[str, tuple[str, ...]]
    seconds: Mapping[str, float]
    file: str = ""


def load_baseline(path: Path) -> Baseline:
    """Read a baseline; one that is not there holds nothing.

    Raises
    ------
    ConfigError
        It is no baseline.
    """
    remedy = "Restore it, or write it anew: livlab validate --update-baseline."
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return Baseline({}, {})
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path} cannot be read as a baseline: {error}.", remedy=remedy) from None
    try:
        if data["schema"] != SCHEMA:
            raise ConfigError(f"{path}: schema {data['schema']!r}; this livlab reads {SCHEMA}.", remedy=remedy)
        found = data["experiments"]
        holds = {str(n): tuple(str(c) for c in e["holds"]) for n, e in found.items()}
        seconds = {str(n): float(e["seconds"]) for n, e in found.items() if e.get("seconds") is not None}
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ConfigError(f"{path} is no baseline: {error!r}.", remedy=remedy) from None
    return Baseline(holds, seconds, path.name)


def verdicts(ended: Mapping[str, Ended]) -> dict[str, dict[str, tuple[str, str]]]:
    """Verdict and note of every claim, by experiment; an experiment that is not complete, or is damaged, has none."""
    return {name: {c.criterion: (c.verdict, c.note) for c in own} for name, own in claims_of(ended).items()}


def compare(
    baseline: Baseline, ended: Mapping[str, Ended], unrecorded: Sequence[Unrecorded], only: Sequence[str] = ()
) -> tuple[list[Change], list[Change]]:
    """Claims lost and claims gained against a baseline.

    A claim is lost if it held and now fails, is missing, or is gone, be it that its experiment did not run. One that
    is too close now is neither: see `undecided`. With `only`, other experiments are not looked at.
    """
    now = verdicts(ended)
    lost = [c for c in _changed(baseline, ended, unrecorded, only) if c.verdict != "TOO CLOSE"]
    gained = []
    for name, found in now.items():
        if only and name not in only:
            continue
        held = baseline.holds.get(name, ())
        gained += [
            Change(name, claim, "PASS")
            for claim, (verdict, _) in found.items()
            if verdict == "PASS" and claim not in held and not is_unrecorded(claim, unrecorded)
        ]
    return lost, gained


def undecided(
    baseline: Baseline, ended: Mapping[str, Ended], unrecorded: Sequence[Unrecorded], only: Sequence[str] = ()
) -> list[Change]:
    """Claims that held, and lie too close to their limit now: nothing is lost, and nothing shown."""
    return [c for c in _changed(baseline, ended, unrecorded, only) if c.verdict == "TOO CLOSE"]


def _changed(
    baseline: Baseline, ended: Mapping[str, Ended], unrecorded: Sequence[Unrecorded], only: Sequence[str]
) -> list[Change]:
    """Claims of the baseline that do not pass now."""
    now = verdicts(ended)
    found = []
    for name, claims in baseline.holds.items():
        if only and name not in only:
            continue
        for claim in claims:
            if is_unrecorded(claim, unrecorded):
                continue
            verdict, note = now.get(name, {}).get(claim, ("MISSING", _absent(ended.get(name))))
            if verdict != "PASS":
                found.append(Change(name, claim, verdict, note))
    return found


def updated(
    baseline: Baseline,
    ended: Mapping[str, Ended],
    unrecorded: Sequence[Unrecorded],
    only: Sequence[str] = (),
    seconds: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """A baseline of what holds now.

    What was not looked at, or did not run, keeps what was known of it; what is no experiment any more is left out.
    """
    now = verdicts(ended)
    took = {**baseline.seconds, **(seconds or {})}
    experiments: dict[str, Any] = {}
    for name, e in ended.items():
        fresh = e.state == "complete" and (not only or name in only)
        holds = (
            [c for c, (verdict, _) in now[name].items() if verdict == "PASS" and not is_unrecorded(c, unrecorded)]
            if fresh
            else list(baseline.holds.get(name, ()))
        )
        if holds or fresh or name in baseline.holds:
            experiments[name] = {"seconds": None if name not in took else round(took[name], 1), "holds": holds}
    return {"schema": SCHEMA, "livlab": __version__, "experiments": experiments}


def write_baseline(path: Path, data: Mapping[str, Any]) -> None:
    """Write a baseline, whole or not at all.

    Raises
    ------
    EnvironmentProblem
        It cannot be written.
    """
    write_whole(path, json.dumps(data, indent=1, ensure_ascii=False) + "\n")


def told(
    baseline: Baseline, lost: Sequence[Change], gained: Sequence[Change], undecided: Sequence[Change] = ()
) -> dict[str, Any]:
    """The comparison as the record keeps it."""
    return {
        "file": baseline.file,
        "holds": {name: list(claims) for name, claims in baseline.holds.items()},
        "lost": [asdict(c) for c in lost],
        "undecided": [asdict(c) for c in undecided],
        "gained": [asdict(c) for c in gained],
    }


def is_unrecorded(claim: str, unrecorded: Sequence[Unrecorded]) -> bool:
    """Whether a claim is one that baselines leave out."""
    return any(fnmatchcase(claim, u.claim) for u in unrecorded)


def _absent(ended: Ended | None) -> str:
    if ended is None:
        return "its experiment is gone"
    if ended.state != "complete":
        return f"its experiment has no result: {ended.reason}"
    return "the experiment no longer makes this claim"
