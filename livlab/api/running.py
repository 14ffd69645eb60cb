"""Experiments from a notebook: run one, or open a run that is there."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from livlab.api.arguments import explained
from livlab.api.claims import Claims
from livlab.api.curve import Spectrum
from livlab.config.kinds import KINDS
from livlab.config.load import check_experiment, load_experiment
from livlab.config.schema import Experiment
from livlab.core import markup
from livlab.errors import InputError
from livlab.runs.work import Progress, Silent

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.axes import Axes

    from livlab.kinds.again import Again
    from livlab.reports.folder import RunData


@dataclass(frozen=True, eq=False, repr=False)
class RunResult:
    """A run folder, read when it is asked.

    Attributes
    ----------
    folder
        Where it is.
    cached
        Whether the result was there before this call.
    """

    folder: Path
    cached: bool = False

    @cached_property
    def _data(self) -> RunData:
        from livlab.reports.folder import read_run

        return read_run(self.folder)

    @property
    def manifest(self) -> dict[str, Any]:
        """What the run says of itself: versions, seed, variant, times, hashes."""
        return self._data.manifest

    @property
    def name(self) -> str:
        """Name of the experiment."""
        return str(self.manifest.get("name", self.folder.name))

    @property
    def kind(self) -> str:
        """Kind of the experiment."""
        return str(self.manifest.get("kind", ""))

    @property
    def complete(self) -> bool:
        """Whether it finished."""
        return self._data.complete

    @property
    def notes(self) -> tuple[str, ...]:
        """Warnings of the run."""
        return tuple(str(x) for x in self.manifest.get("notes", ()))

    @property
    def experiment(self) -> Experiment:
        """The experiment with every default written out."""
        return load_experiment(self.folder / "config.toml")

    @property
    def report(self) -> Path | None:
        """The report's page; None if it was not built."""
        page = self.folder / "report.html"
        return page if page.is_file() else None

    @cached_property
    def claims(self) -> Claims:
        """What was judged."""
        from livlab.criteria import read_claims

        path = self.folder / "claims.csv"
        return Claims(read_claims(path) if path.is_file() else ())

    @property
    def tables(self) -> tuple[str, ...]:
        """Names of the CSV tables, for `table`."""
        return tuple(self._data.tables)

    def table(self, name: str) -> pd.DataFrame:
        """One CSV table.

        Raises
        ------
        InputError
            The run has none of that name.
        """
        if name not in self.tables:
            from livlab.config.errors import nearest

            hint = nearest(name, list(self.tables)) or f"It has: {', '.join(self.tables)}."
            raise InputError.of("table", name, f"is none of run {self.name}", hint)
        return self._data.table(name).copy()

    @property
    def result(self) -> xr.Dataset:
        """The root group of result.nc (docs/experiments.md).

        Raises
        ------
        InputError
            The run has none, or did not get that far.
        """
        if self._data.result is None:
            raise InputError.of("run folder", str(self.folder), "has no result.nc", "Run it to its end; see `tables`.")
        return self._data.result

    @cached_property
    def spectra(self) -> dict[str, Spectrum]:
        """Spectrum by reading, of a spectral run; of a fit the fitted one.

        Raises
        ------
        InputError
            A run of another kind.
        """
        if self.kind == "fit":
            x = self.result
            grid, value, se = (x[k].to_numpy() for k in ("wavelength", "reflectance", "reflectance_se"))
            return {"fitted": Spectrum(grid, value, se, f"{self.name}, fitted")}
        if self.kind != "spectral":
            raise InputError.of("kind", self.kind, "has no spectra", "See `tables` and `result`.")
        found = {}
        for label in (str(r) for r in self.result["reading"].values):
            own = self.result.sel(reading=label)
            grid, value, se = (own[k].to_numpy() for k in ("wavelength", "reflectance", "reflectance_se"))
            found[label] = Spectrum(grid, value, se, label)
        return found

    def spectrum(self, reading: str | None = None) -> Spectrum:
        """One of `spectra`; the only one if no reading is said."""
        if reading is None and len(self.spectra) == 1:
            return next(iter(self.spectra.values()))
        if reading not in self.spectra:
            raise InputError.of("reading", reading, f"must be one of {', '.join(self.spectra)}", "Name one.")
        return self.spectra[reading]

    def to_pandas(self) -> pd.DataFrame:
        """The kind's main table (`livlab.config.kinds`): spectra of a spectral run, parameters of a fit, and so on.

        A run that did not get that far answers with its claims.
        """
        kind = KINDS.get(self.kind)
        main = next((name for name in kind.main_tables if name in self.tables), "") if kind else ""
        return self.table(main) if main else self.claims.to_pandas()

    def plot(self, ax: Axes | None = None) -> Axes:
        """Every spectrum on the same axes; returns them.

        Raises
        ------
        InputError
            A run of a kind that has no spectra; its report has its figures.
        """
        from livlab.api.draw import axes

        spectra = self.spectra
        ax = axes(ax)
        for found in spectra.values():
            found.plot(ax)
        ax.legend()
        return ax

    def __repr__(self) -> str:
        state = "complete" if self.complete else str(self.manifest.get("status", "unknown"))
        return f"<RunResult {self.name!r} ({self.kind}, {state}): {repr(self.claims)[1:-1]}, {str(self.folder)!r}>"

    def _repr_html_(self) -> str:
        rows = [
            ("kind", self.kind),
            ("status", self.manifest.get("status", "unknown")),
            ("folder", str(self.folder)),
            ("seed", str(self.manifest.get("seed", ""))),
            ("seconds", str(self.manifest.get("seconds", ""))),
            ("livlab", self.manifest.get("livlab", "")),
            ("tables", ", ".join(self.tables)),
        ]
        title = str(self.manifest.get("title") or self.name)
        claims = self.claims._repr_html_() if self.claims else ""
        return markup.card(title, self.name, markup.table(["", ""], rows), claims, markup.notes(self.notes))


class PrintedProgress(Silent):
    """Progress as lines on stderr, some seconds apart."""

    every_seconds = 5.0

    def __init__(self) -> None:
        self._last = -self.every_seconds

    def advance(self, task: str, share: float, text: str = "") -> None:
        """Say how far a task is, if some seconds went by or it is done."""
        now = time.monotonic()
        if share >= 1.0 or now - self._last >= self.every_seconds:
            self._last = now
            self.say(f"{task}: {int(100 * share)} %{f' ({text})' if text else ''}")

    def say(self, text: str) -> None:
        """One line."""
        print(text, file=sys.stderr, flush=True)


@explained
def run(
    config: Experiment | Mapping[str, Any] | Path | str,
    *,
    out: Path | str = "runs",
    force: bool = False,
    report: bool = True,
    progress: Progress | bool = False,
    scheduler: str = "local",
    store: Path | None = None,
) -> RunResult:
    """Run an experiment, or find that it has been run: `livlab run` from Python, with the same numbers and folder.

    Parameters
    ----------
    config
        An experiment file, the bare name of one of livlab's own ("spectral"), a table as the file would have
        (`schema` may be left out), or an experiment.
    out
        Folder that holds the run folders.
    force
        Do it again even if the result is there.
    report
        Whether to build the report.
    progress
        True prints lines; or an object of one's own (`livlab.runs.work.Progress`).
    scheduler, store
        Of a study: where its jobs run, and a folder of results that several runs share.

    Raises
    ------
    ConfigError
        What does not fit the form.
    DatasetError, RangeError
        A dataset that is missing, changed, or does not reach.
    EnvironmentProblem
        The folder cannot be written, or there is no usable libLLVM.
    Interrupted
        The user stopped it; calling again goes on.
    """
    from livlab.kinds.execute import execute

    if isinstance(config, Experiment):
        experiment = config
    elif isinstance(config, Mapping):
        experiment = check_experiment(plain(config), source="livlab.run")
    elif isinstance(config, (str, Path)):
        experiment = load_experiment(config)
    else:
        raise InputError.of("config", type(config).__name__, "is no experiment", "Give a path, a name or a table.")
    outcome = execute(
        experiment,
        base=Path(out),
        force=force,
        progress=_watched(progress),
        report=report,
        scheduler=scheduler,
        shared=store,
    )
    return RunResult(outcome.folder, outcome.cached)


def open_run(folder: Path | str) -> RunResult:
    """A run that is there, complete or not.

    Raises
    ------
    InputError
        The folder is none that `livlab run` wrote, or it is damaged.
    """
    found = RunResult(Path(folder), cached=True)
    _ = found.manifest  # a folder that is no run is told here, and not at the first question
    return found


@explained
def rerun(run: RunResult | Path | str, *, out: Path | str | None = None, progress: Progress | bool = False) -> Again:
    """Do a run again from its manifest and compare every file of the result: `livlab rerun` from Python.

    Parameters
    ----------
    run
        A run, its folder, or a manifest.json alone.
    out
        Folder for the new run folder; `reruns` beside the run if not said.
    progress
        As `livlab.run`.

    Returns
    -------
    The comparison; `same` says whether the results are the same, `differences` what is not as it was.

    Raises
    ------
    InputError, DatasetError
        As `livlab.kinds.again.read_original` and `run_again`.
    """
    from livlab.kinds.again import read_original, run_again

    folder = run.folder if isinstance(run, RunResult) else Path(run)
    base = None if out is None else Path(out)
    return run_again(read_original(folder), base, progress=_watched(progress), report=False)


def _watched(progress: Progress | bool) -> Progress:
    return (PrintedProgress() if progress else Silent()) if isinstance(progress, bool) else progress


def plain(value: Any) -> Any:
    """A table in TOML's own types: NumPy's numbers and arrays, tuples and paths become plain ones."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, Sequence) and not isinstance(value, (str, bytes)):
        return [plain(v) for v in value]
    return value
