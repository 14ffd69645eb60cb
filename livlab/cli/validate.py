"""`livlab validate`: run or reuse every experiment, and build the dossier."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer
from rich.console import Console
from rich.table import Table

from livlab.errors import ConfigError, Interrupted

if TYPE_CHECKING:
    from livlab.criteria import FamilyError
    from livlab.dossier.baseline import Baseline, Change
    from livlab.dossier.validate import Ended, Planned

RECORD = "validation.json"


class Changes(NamedTuple):
    """What is not as the baseline has it."""

    lost: list[Change]
    undecided: list[Change]
    gained: list[Change]


def register(app: typer.Typer) -> None:
    """Register the command."""
    app.command("validate")(validate)


def validate(
    out: Annotated[Path, typer.Option("--out", help="Folder for the site.")] = Path("dossier"),
    runs: Annotated[Path, typer.Option("--runs", help="Folder that holds the run folders.")] = Path("runs"),
    only: Annotated[
        list[str] | None,
        typer.Option("--only", help="Run only these experiments; others are shown if done.", metavar="NAME..."),
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Exit with 1, and name them, if claims that held no longer hold.")
    ] = False,
    update_baseline: Annotated[
        bool, typer.Option("--update-baseline", help="Record which claims hold now, and what each experiment takes.")
    ] = False,
    scheduler: Annotated[
        str, typer.Option("--scheduler", help="Where the jobs of studies run: local, processes:N or tcp://HOST:PORT.")
    ] = "local",
    dossier: Annotated[
        Path | None, typer.Option("--dossier", help="What the site covers (TOML); livlab's own if not said.")
    ] = None,
    baseline: Annotated[
        Path | None, typer.Option("--baseline", help="The baseline; baseline.json beside the dossier's file.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print only the site's path, and what fails.")] = False,
) -> None:
    """Run or reuse every experiment and build the dossier: every claim, and the thesis's figures beside ours."""
    from livlab.dossier.baseline import compare, load_baseline, told, undecided, updated, write_baseline
    from livlab.dossier.config import builtin_dossier, load_dossier
    from livlab.dossier.sure import claims_of, family_of, family_record
    from livlab.dossier.validate import planned, record

    file = dossier or builtin_dossier()
    config = load_dossier(file)
    held_file = baseline or file.with_name("baseline.json")
    held = load_baseline(held_file)
    chosen = tuple(only or ())
    _checkable(held_file, held if check else None)
    if scheduler != "local":
        from livlab.jobs.scheduler import open_scheduler

        open_scheduler(scheduler)  # a slip is told before anything runs
    experiments = planned(config, file, chosen)
    try:
        ended = _run_all(experiments, runs, only=chosen, expected=dict(held.seconds), scheduler=scheduler, quiet=quiet)
    except (KeyboardInterrupt, Interrupted):
        again = f"livlab validate --out {out} --runs {runs}"
        raise Interrupted("Stopped; what is done is kept.", remedy=f"To go on: {again}") from None
    if update_baseline:
        taken = {n: _seconds(e) for n, e in ended.items() if e.folder is not None}
        write_baseline(held_file, updated(held, ended, config.unrecorded, chosen, taken))
        held = load_baseline(held_file)
    lost, gained = compare(held, ended, config.unrecorded, chosen)
    changed = Changes(lost, undecided(held, ended, config.unrecorded, chosen), gained)
    family = family_of(claims_of(ended))
    known, sure = told(held, lost, gained, changed.undecided), family_record(family)
    page = _site(record(config, experiments, ended, known, out, family=sure), out)
    _show(experiments, ended, quiet=quiet)
    _sure(family, quiet=quiet)
    _changes(held, changed, quiet=quiet)
    typer.echo(page)
    if check and lost:
        raise typer.Exit(1)


def _checkable(file: Path, held: Baseline | None) -> None:
    if held is not None and not held.file:
        raise ConfigError(f"{file}: there is no baseline to check against.", remedy="Make it: --update-baseline.")


def _run_all(
    experiments: list[Planned],
    runs: Path,
    *,
    only: tuple[str, ...],
    expected: dict[str, float],
    scheduler: str,
    quiet: bool,
) -> dict[str, Ended]:
    """Run or reuse every experiment, each in a process of its own."""
    from livlab.cli.apart import runner
    from livlab.dossier.validate import validate as work

    console = Console(stderr=True, soft_wrap=True)

    def say(text: str) -> None:
        if not quiet:
            console.print(text, highlight=False, markup=False)

    return work(
        experiments,
        runner(runs, scheduler=scheduler, quiet=quiet),
        runs,
        only=only,
        expected=expected,
        say=say,
    )


def _seconds(e: Ended) -> float:
    """What a run took when it ran, be it now or before."""
    from livlab.runs.identity import read_manifest

    return float(read_manifest(e.folder).get("seconds", e.seconds)) if e.folder is not None else e.seconds


def _site(data: dict[str, object], out: Path) -> Path:
    from livlab.core.files import write_whole
    from livlab.dossier.build import build_dossier
    from livlab.runs.files import open_folder

    open_folder(out)
    write_whole(out / RECORD, json.dumps(data, indent=1, ensure_ascii=False) + "\n")
    return build_dossier(out)


def _show(experiments: list[Planned], ended: dict[str, Ended], *, quiet: bool) -> None:
    """A line an experiment, then what is missing: it is never silent."""
    from livlab.dossier.baseline import verdicts

    found = verdicts(ended)
    console = Console(width=None if Console().is_terminal else 160)
    if not quiet:
        table = Table(header_style="bold", box=None, pad_edge=False)
        for name in ("experiment", "", "PASS", "FAIL", "TOO CLOSE", "MISSING", "seconds"):
            table.add_column(name, justify="left" if name in ("experiment", "") else "right")
        for one in experiments:
            e = ended[one.name]
            counts = Counter(verdict for verdict, _ in found[one.name].values())
            state = "done before" if e.cached else e.state
            table.add_row(
                one.name,
                state,
                *(str(counts[v] or "") for v in ("PASS", "FAIL", "TOO CLOSE")),
                str(counts["MISSING"] or "") if e.state == "complete" else "all",
                "" if e.cached else f"{e.seconds:.0f}",
            )
        console.print(table)
        total = Counter(verdict for claims in found.values() for verdict, _ in claims.values())
        seconds = sum(e.seconds for e in ended.values())
        console.print(
            f"{total['PASS']} PASS, {total['FAIL']} FAIL, {total['MISSING']} MISSING, {total['TOO CLOSE']} TOO CLOSE; "
            f"{seconds:.0f} s.",
            highlight=False,
        )
    for one in experiments:
        e = ended[one.name]
        if e.state != "complete":
            console.print(f"MISSING {one.name}: {e.reason}", highlight=False, markup=False, soft_wrap=True)


def _sure(family: FamilyError, *, quiet: bool) -> None:
    """How sure the verdicts are together."""
    if quiet or not family.claims:
        return
    Console(soft_wrap=True).print(
        f"{family.claims} claims are statistical. Were every truth at its limit, at least one verdict would be wrong "
        f"with a chance of up to {100 * family.at_most:.0f} % (Šidák). Of {len(family.failed)} that FAIL, "
        f"{len(family.doubtful)} could be a false alarm among so many (Holm).",
        highlight=False,
        markup=False,
    )


def _changes(held: Baseline, found: Changes, *, quiet: bool) -> None:
    lost, gained = found.lost, found.gained
    console = Console(soft_wrap=True)

    def say(text: str) -> None:
        console.print(text, highlight=False, markup=False)

    for c in lost:
        say(f"HELD BEFORE, NOW {c.verdict}: {c.experiment}: {c.claim}" + (f" ({c.why})" if c.why else ""))
    for c in found.undecided:
        say(f"HELD BEFORE, NOW TOO CLOSE: {c.experiment}: {c.claim}" + (f" ({c.why})" if c.why else ""))
    if quiet:
        return
    if not held.file:
        say("There is no baseline yet; --update-baseline records which claims hold.")
        return
    if not lost:
        say("Every claim of the baseline that was looked at holds" + (", or is too close." if found.undecided else "."))
    for c in gained:
        say(f"HOLDS NOW, NOT IN THE BASELINE: {c.experiment}: {c.claim}")
    if gained:
        say("To record what holds now: livlab validate --update-baseline")
