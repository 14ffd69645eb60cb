"""The files of a run and of the same run done again, each compared under the names and rules of the first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from livlab.runs.compare import FileVerdict, compare_file
from livlab.runs.files import sha256
from livlab.runs.old import CLAIM_FILES, RULE_SINCE, as_then, claims_as_then, judged_otherwise, old_names

RULE_CHANGED = f"the verdict rule is another since result version {RULE_SINCE}"


def compared_files(
    then: Mapping[str, Any], before: Path, now: Path, made: Mapping[str, str]
) -> tuple[FileVerdict, ...]:
    """Each file of either run.

    Parameters
    ----------
    then
        The first run's manifest.
    before, now
        The two folders; of the first the manifest is enough.
    made
        Files of the second, with their hashes.
    """
    known = then["files"]
    files = []
    # Verdicts by the rule of then are held against today's numbers, judged by that rule.
    former = claims_as_then(now) if judged_otherwise(then, before) else None
    for name in dict.fromkeys((*known, *made)):
        if name == "config.toml":  # what went in, and not what came out: its digest is compared
            continue
        old = before / name
        # A file that was changed since the run says nothing; its hash in the manifest still does.
        there = old if name in known and old.is_file() and sha256(old) == known[name] else None
        if former is not None and name in CLAIM_FILES:
            files += _judged_then(then, name, there, former.get(name))
        else:
            files.append(_compared(then, name, there, now / name if name in made else None))
    return tuple(files)


def _compared(then: Mapping[str, Any], name: str, old: Path | None, new: Path | None) -> FileVerdict:
    """One file of the two runs; what has another name since is compared under the old one, and told."""
    told: list[str] = []

    def under_old_names(raw: bytes) -> bytes:
        renamed = as_then(then, name, raw)
        if renamed != raw:
            told.extend(f"{before} is now {now}" for before, now in old_names(then, name).items())
        return renamed

    known, timeless = then["files"].get(name, ""), then.get("results", {}).get(name, "")
    verdict = compare_file(name, old, new, known, timeless, under_old_names)
    return replace(verdict, detail="; ".join(filter(None, (", ".join(told), verdict.detail))))


def _judged_then(then: Mapping[str, Any], name: str, old: Path | None, now: bytes | None) -> list[FileVerdict]:
    """Claims or their notes of an older run against today's under the rule of then; nothing where neither has any."""
    known, timeless = then["files"].get(name, ""), then.get("results", {}).get(name, "")
    if now is None and not known:
        return []
    verdict = compare_file(name, old, now, known, timeless)
    told = f"{RULE_CHANGED}: compared by the former" if now is not None and known else RULE_CHANGED
    return [replace(verdict, detail="; ".join(filter(None, (told, verdict.detail))))]


__all__ = ["compared_files"]
