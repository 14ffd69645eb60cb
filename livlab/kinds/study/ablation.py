"""Ablation: options of a reading changed one by one, or all the way to another, and effects left out one by one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np

from livlab.acquire.instruments.models import Instrument
from livlab.effects.catalogue import catalogue
from livlab.effects.scene import OpticalScene
from livlab.errors import InputError
from livlab.kinds.study.config import StudyExperiment
from livlab.kinds.study.config_parts import Target
from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.readings import READINGS, Reading, reading, rows
from livlab.model.tissue.stack import OpticalStack
from livlab.model.tissue.tissue import Tissue
from livlab.units import FloatArray

_COSINES = np.array([-0.95, -0.4, 0.1, 0.6, 0.9, 0.99])


@dataclass(frozen=True)
class AblationCase:
    """One thing changed.

    Attributes
    ----------
    label, group
        Its name; "base", "option", "path" or "effect".
    base
        Label of the case that its change is held against.
    row, option, choice
        Row of the table of contradictions, the option changed, and to what; or the effect left out.
    reading, without
        How the tissue is read, and the effects left out.
    same_as
        Label of a case with the very same scene, whose curve is taken over; empty where there is none.
    """

    label: str
    group: str
    base: str
    row: int | None
    option: str
    choice: str
    reading: Reading
    without: tuple[str, ...] = ()
    same_as: str = ""


def cases(config: StudyExperiment) -> list[AblationCase]:
    """Every case of an ablation, bases first; what leaves the scene as it is says whose curve it has.

    Raises
    ------
    InputError
        A tissue that a reading cannot take.
    """
    assert config.ablation is not None
    spec, tissue, grid = config.ablation, config.tissue.build(), config.wavelengths.grid()
    bases = [READINGS[n] for n in spec.bases] or [config.reading]
    numbers = {str(r["option"]): r["row"] for r in rows().to_dict("records")}
    made = [AblationCase(b.name, "base", b.name, None, "", "", b) for b in bases]
    for base in bases:
        for option in spec.options or tuple(numbers):
            for choice in _choices(option, spec.choices):
                if choice != getattr(base, option):
                    changed = _with(base, {option: choice})
                    made.append(
                        AblationCase(
                            changed.name, "option", base.name, _row(numbers[option]), option, str(choice), changed
                        )
                    )
    if spec.towards is not None:
        made += _path(bases[0], READINGS[spec.towards], numbers)
    stacks = {c.label: _stack(c, tissue, grid) for c in made}
    if spec.effects:
        made += _effects(bases[0], stacks[bases[0].name], config.instrument, tissue)
    return _told_apart(made, stacks)


def _stack(case: AblationCase, tissue: Tissue, grid: FloatArray) -> OpticalStack:
    """The optical stack of a case; what is wrong is told with the case's name."""
    try:
        return optical_stack(tissue, case.reading, grid)
    except InputError as error:
        raise InputError.of(
            "ablation case", case.label, f"cannot be made: {error.message.rstrip('.')}",
            error.remedy or "Leave its option out.",
        ) from None  # fmt: skip


def _path(start: Reading, end: Reading, numbers: Mapping[str, Any]) -> list[AblationCase]:
    made: list[AblationCase] = []
    at, before = start, start.name
    for option in numbers:
        choice = getattr(end, option)
        if choice == getattr(at, option):
            continue
        at = _with(at, {option: choice})
        label = f"{start.name} → {end.name}, {len(made) + 1}: {option} {choice}"
        made.append(AblationCase(label, "path", before, _row(numbers[option]), option, str(choice), at))
        before = label
    return made


def _effects(base: Reading, stack: OpticalStack, instrument: Instrument, tissue: Tissue) -> list[AblationCase]:
    found = catalogue(OpticalScene(stack, instrument), tissue, base)
    return [
        AblationCase(f"{base.name} without {e.name}", "effect", base.name, None, e.name, "left out", base, (e.name,))
        for e in found
        if e.drop is not None
    ]


def _told_apart(made: Sequence[AblationCase], stacks: Mapping[str, OpticalStack]) -> list[AblationCase]:
    """Name the earlier case with the same scene, so that chance makes no difference where there is none."""
    from dataclasses import replace

    kept: list[AblationCase] = []
    for case in made:
        twin = ""
        if not case.without:
            twin = next(
                (
                    c.label
                    for c in kept
                    if not c.without and not c.same_as and same(stacks[c.label], stacks[case.label])
                ),
                "",
            )
        kept.append(replace(case, same_as=twin))
    return kept


def same(a: OpticalStack, b: OpticalStack) -> bool:
    """Whether light finds the same in both stacks."""
    if a is b:
        return True
    if len(a.layers) != len(b.layers) or not (
        np.array_equal(a.n_above, b.n_above) and np.array_equal(a.n_below, b.n_below)
    ):
        return False
    for x, y in zip(a.layers, b.layers, strict=True):
        if x.thickness_mm != y.thickness_mm or not np.array_equal(x.n, y.n):
            return False
        p = [i for i in x.interactions if i.rate.any()]
        q = [i for i in y.interactions if i.rate.any()]
        if len(p) != len(q):
            return False
        for i, j in zip(p, q, strict=True):
            if (i.redirect, i.absorb_below_mm) != (j.redirect, j.absorb_below_mm):
                return False
            if not (np.array_equal(i.rate, j.rate) and np.array_equal(i.albedo, j.albedo)):
                return False
            if i.albedo.any() and not all(_same_phase(s, t) for s, t in zip(i.phases, j.phases, strict=True)):
                return False
    return True


def _same_phase(s: Any, t: Any) -> bool:
    return s is t or (
        type(s) is type(t) and s.anisotropy == t.anisotropy and np.array_equal(s.pdf(_COSINES), t.pdf(_COSINES))
    )


def distance(values: Mapping[str, float], targets: Sequence[Target]) -> dict[str, float]:
    """How many tolerances each output is off its target; nan where there is no value.

    >>> distance({"pearson": 0.95}, [Target(output="pearson", value=0.97, tolerance=0.01)])["pearson"]
    2.0000000000000018
    """
    return {t.output: abs(values[t.output] - t.value) / t.tolerance for t in targets}


def _with(base: Reading, changes: Mapping[str, Any]) -> Reading:
    return reading(base.base, **{**base.model_dump(exclude={"name", "base"}), **changes})


def _choices(option: str, which: str) -> tuple[Any, ...]:
    if which == "named":
        return tuple(dict.fromkeys(getattr(r, option) for r in READINGS.values()))
    field = Reading.model_fields[option]
    if isinstance(field.json_schema_extra, dict):
        return tuple(field.json_schema_extra["enum"])  # type: ignore[arg-type]
    return get_args(field.annotation)


def _row(value: Any) -> int | None:
    try:
        return int(value)
    except (TypeError, ValueError):  # pandas' NA: the option is livlab's own
        return None
