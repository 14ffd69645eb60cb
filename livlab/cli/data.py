"""`livlab data`: what datasets there are, what they say of themselves, whether they are intact, and adding one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from livlab.cli.console import table_console
from livlab.errors import DatasetError, InputError, Interrupted

if TYPE_CHECKING:
    from livlab.datasets import DatasetMeta
    from livlab.datasets.draft import Draft

app = typer.Typer(help="Datasets: list, show, check, plot, add, licences.", no_args_is_help=True)

WIDTH = 220
"""Of tables that are not printed on a screen."""

_T = TypeVar("_T")
_KINDS_MEAN = " (tabulated: numbers as measured or published; digitised: read off a figure; fit; assumed)"
Search = Annotated[
    list[Path] | None,
    typer.Option("--search", help="A further folder of datasets (say, beside an experiment). Repeatable."),
]
Name = Annotated[str, typer.Argument(help="Name of a dataset; livlab data list shows them.")]


@app.command("list")
def list_(search: Search = None) -> None:
    """List the datasets there are, and the references that are not to be had."""
    from rich.markup import escape
    from rich.table import Table

    from livlab import datasets

    console = table_console(WIDTH)
    table = Table(box=None, pad_edge=False)
    for heading in ("name", "kind", "range, nm", "rows", "from"):
        table.add_column(heading, no_wrap=True)
    table.add_column("title")
    builtin = datasets.builtin_root()
    found = datasets.names(search=search or ())
    for name in found:
        try:
            dataset = datasets.load(name, search=search or ())
        except DatasetError as error:
            table.add_row(name, "[red]damaged[/]", "", "", "", escape(error.message))
            continue
        covers = "-" if not dataset.is_spectrum else f"{dataset.range_nm[0]:g} to {dataset.range_nm[1]:g}"
        origin = "livlab" if dataset.path.parent == builtin else escape(str(dataset.path.parent))
        table.add_row(name, dataset.meta.kind, covers, str(len(dataset)), origin, escape(dataset.meta.title))
    console.print(table)
    missing = {name: entry for name, entry in datasets.unavailable().items() if name not in found}
    if missing:
        console.print("\nReferences that are not available; livlab data show NAME says how to supply one:")
        for name, entry in missing.items():
            console.print(f"  {name}  {escape(entry.title)}", highlight=False)


@app.command()
def licences() -> None:
    """Print sources and licences of livlab's own datasets as Markdown."""
    from livlab.datasets.licences import licences_page

    typer.echo(licences_page(), nl=False)


@app.command()
def show(
    name: Name,
    rows: Annotated[int, typer.Option(min=0, help="Rows to print from the head.")] = 5,
    search: Search = None,
) -> None:
    """Show what a dataset says about itself, and its first rows."""
    from rich.markup import escape
    from rich.table import Table

    from livlab.datasets import load

    dataset = load(name, search=search or ())
    meta, console = dataset.meta, table_console(WIDTH)
    covers = f"{dataset.range_nm[0]:g} to {dataset.range_nm[1]:g} nm" if dataset.is_spectrum else ""
    relative = "" if meta.uncertainty.relative is None else f" (relative {meta.uncertainty.relative:g})"
    facts = {
        "name": f"{meta.name}, version {meta.version}",
        "title": meta.title,
        "source": meta.source,
        "doi": meta.doi or "",
        "url": meta.url or "",
        "kind": meta.kind,
        "range": covers,
        "uncertainty": meta.uncertainty.text + relative,
        "licence": meta.licence,
        "read in": meta.read_in,
        "notes": meta.notes,
        "sha256": f"{meta.sha256} (verified)",
        "folder": str(dataset.path),
    }
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(no_wrap=True, style="bold")
    table.add_column(overflow="fold")
    for key, text in facts.items():
        if text:
            table.add_row(key, escape(text))
    console.print(table)
    columns = Table(box=None, pad_edge=False, title="columns", title_justify="left")
    for heading in ("name", "unit", "what"):
        columns.add_column(heading, overflow="fold")
    for column, about in meta.columns.items():
        also = f" (also: {', '.join(about.aliases)})" if about.aliases else ""
        columns.add_row(column, about.unit or "text", escape(about.description + also))
    console.print()
    console.print(columns)
    if rows:
        console.print(f"\nfirst {min(rows, len(dataset))} of {len(dataset)} rows")
        typer.echo(dataset.table.head(rows).to_string(index=False))


@app.command()
def check(
    name: Annotated[str | None, typer.Argument(help="Name of a dataset; all if absent.")] = None, search: Search = None
) -> None:
    """Check hash, columns, order and range of one dataset or of all; exit status 2 if one is damaged."""
    from rich.markup import escape

    from livlab import datasets

    folders = search or ()
    results = [datasets.check(name, search=folders)] if name else datasets.check_all(search=folders)
    console = table_console(WIDTH)
    for result in results:
        verdict = "[green]ok[/]     " if result.ok else "[red]damaged[/]"
        console.print(f"{verdict} {result.name}", highlight=False)
        if not result.ok:
            console.print(f"        {escape(result.problem)}\n        {escape(result.remedy)}", highlight=False)
    bad = [result.name for result in results if not result.ok]
    if bad:
        raise DatasetError(f"{len(bad)} of {len(results)} datasets are damaged: {', '.join(bad)}.", remedy="See above.")
    console.print(f"{len(results)} checked, none damaged.")


@app.command()
def plot(
    name: Name,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="SVG, PNG or PDF; NAME.svg if absent.")] = None,
    search: Search = None,
) -> None:
    """Draw a dataset to a file."""
    from livlab.datasets import load
    from livlab.datasets.plot import plot as draw
    from livlab.datasets.plot import save

    dataset = load(name, search=search or ())
    typer.echo(save(draw(dataset), output or Path(f"{dataset.name}.svg")))


@app.command()
def add(
    file: Annotated[Path, typer.Argument(help="A CSV: wavelength and values; comma, semicolon or tab.")],
    name: Annotated[str | None, typer.Option(help="Name to use in experiments.")] = None,
    title: Annotated[str | None, typer.Option(help="What it is, in a line.")] = None,
    source: Annotated[str | None, typer.Option(help="Who measured it, where it was published.")] = None,
    kind: Annotated[str | None, typer.Option(help="tabulated, digitised, fit or assumed.")] = None,
    unit: Annotated[str | None, typer.Option(help="Unit of the columns that have none: 1, %, 1/cm, 1/mm, ...")] = None,
    column: Annotated[
        list[str] | None,
        typer.Option(help="NAME or NAME:UNIT of a column after the wavelength, in order. Repeatable."),
    ] = None,
    doi: Annotated[str | None, typer.Option(help="DOI, 10.xxxx/...")] = None,
    licence: Annotated[str | None, typer.Option(help="What may be done with it.")] = None,
    uncertainty: Annotated[str | None, typer.Option(help="How sure the numbers are, in words.")] = None,
    relative_uncertainty: Annotated[float | None, typer.Option(help="Relative error, 0.05 for 5 %.")] = None,
    wavelength_unit: Annotated[str | None, typer.Option(help="nm or um.")] = None,
    no_wavelength: Annotated[bool, typer.Option("--no-wavelength", help="A table of parameters.")] = False,
    sort: Annotated[bool, typer.Option("--sort", help="Sort the rows by wavelength.")] = False,
    replace: Annotated[bool, typer.Option("--replace", help="Replace your dataset of that name.")] = False,
    into: Annotated[Path | None, typer.Option(help="Folder of datasets to add to; yours if absent.")] = None,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Ask nothing: options and defaults only.")] = False,
) -> None:
    """Add your own table to the catalogue: read it, say what was understood, ask what is missing, write it whole."""
    from livlab.datasets.add import add as write
    from livlab.datasets.draft import read_draft

    draft = read_draft(
        file,
        columns=column or (),
        unit=unit,
        wavelength_unit=wavelength_unit,
        sort=sort,
        wavelength=not no_wavelength,
    )
    for sentence in draft.understood:
        typer.echo(f"understood: {sentence}")
    given = {"name": name, "title": title, "source": source, "kind": kind, "doi": doi}
    given |= {"licence": licence, "uncertainty": uncertainty}
    try:
        draft, about = _asked(draft, given, into, replace=replace, yes=yes)
    except typer.Abort as stop:
        raise Interrupted(
            "Nothing was added.", remedy="To add without questions: --name --source --kind --unit and --yes."
        ) from stop
    kept = dict[str, Any](**about, relative_uncertainty=relative_uncertainty, into=into, replace_existing=replace)
    folder = write(draft, **kept)
    typer.echo(f"added: {about['name']} in {folder}")
    typer.echo(f"Use it by name in an experiment, and see it with: livlab data plot {about['name']}")


def _asked(
    draft: Draft, given: dict[str, str | None], into: Path | None, *, replace: bool, yes: bool
) -> tuple[Draft, dict[str, str]]:
    """Units and what else is to be known of a dataset: as given, as known, or as the user answers."""
    from livlab.datasets.add import existing_meta, free_name
    from livlab.datasets.meta import KINDS
    from livlab.datasets.readers.raw import suggested_name

    def named(text: str) -> str:
        return free_name(text, into, replace_existing=replace)

    def of_kind(text: str) -> str:
        return _one_of(text, KINDS)

    name = _ask("name", given["name"], suggested_name(draft.source_file), yes, named)
    before = existing_meta(name, into) if replace else None
    known = {"title": name.replace("_", " "), "doi": "", "licence": "not stated", "uncertainty": "not stated"}
    known |= _known(name, before)
    draft = _ask_units(draft, before, yes)
    questions: tuple[tuple[str, Callable[[str], str], str], ...] = (
        ("title", _some_text, ""),
        ("source", _some_text, " (who measured it, where, when)"),
        ("kind", of_kind, _KINDS_MEAN),
        ("doi", str.strip, ""),
        ("licence", _some_text, ""),
        ("uncertainty", _some_text, ""),
    )
    about = {"name": name}
    for option, parse, of in questions:
        about[option] = _ask(option, given[option], known.get(option), yes, parse, of=of)
    _report(draft)
    if not yes and not typer.confirm(f"Add it as {name}?", default=True):
        raise typer.Abort
    return draft, about


def _known(name: str, before: DatasetMeta | None) -> dict[str, str]:
    """Return what is known of a dataset before asking: its former self, or the entry of the reference it supplies."""
    from livlab.datasets import unavailable

    if before is not None:
        about = {"title": before.title, "source": before.source, "kind": before.kind, "licence": before.licence}
        return {**about, "doi": before.doi or "", "uncertainty": before.uncertainty.text}
    entry = unavailable().get(name)
    return {} if entry is None else {"title": entry.title, "source": entry.source, "doi": entry.doi or ""}


def _ask_units(draft: Draft, before: DatasetMeta | None, yes: bool) -> Draft:
    from livlab.datasets.quantity import require_unit

    asked = {}
    for column, unit in draft.units.items():
        if unit is None:
            default = before.columns[column].unit if before and column in before.columns else None
            asked[column] = _ask(
                "unit", None, default, yes, require_unit, of=f" of {column} (1 for a ratio, % for percent)"
            )
    return draft.with_units(asked) if asked else draft


def _ask(
    option: str, given: str | None, default: str | None, yes: bool, parse: Callable[[str], _T], *, of: str = ""
) -> _T:
    if given is not None:
        return parse(given)
    if yes:
        if default is None:
            raise InputError(
                f"{option}{of} is not known.", remedy=f"Give it: --{option} …, or leave --yes out to be asked."
            )
        return parse(default)
    while True:
        answer = typer.prompt(f"{option}{of}", default=default)
        try:
            return parse(str(answer))
        except InputError as error:
            typer.echo(f"{error.message} {error.remedy}")


def _some_text(text: str) -> str:
    if not text.strip():
        raise InputError.of("answer", text, "must not be empty", "Say it in a few words.")
    return text.strip()


def _one_of(text: str, choices: tuple[str, ...]) -> str:
    if text.strip() not in choices:
        raise InputError.of("kind", text, f"must be one of {', '.join(choices)}", "Choose one of them.")
    return text.strip()


def _report(draft: Draft) -> None:
    for column, values in draft.columns.items():
        typer.echo(f"column: {column} [{draft.units[column]}] {values.min():g} to {values.max():g}, {len(values)} rows")
