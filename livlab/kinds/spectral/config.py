"""The spectral experiment: a tissue under several readings, seen by an instrument, held against measured curves."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, Literal, Self

from pydantic import Field, model_validator

from livlab.acquire.instruments.models import Instrument
from livlab.acquire.instruments.solvers import DEFAULT_ACCURACY, Solver, WalkSolver
from livlab.config.errors import nearest
from livlab.config.schema import Experiment, Label
from livlab.criteria import Wanted
from livlab.effects.config import EffectsConfig
from livlab.errors import InputError
from livlab.kinds.shared.criterion import Judged
from livlab.kinds.shared.sections import Processing, Reference, Wavelength, Wavelengths
from livlab.model.tissue.presets import TissueSpec
from livlab.model.tissue.readings import READINGS, Reading, ReadingName
from livlab.model.transport.accuracy import Accuracy

if TYPE_CHECKING:
    pass

MOST_CURVE_POINTS = 2_000


class CriterionSpec(Judged):
    """A claim to judge."""

    metric: Literal["pearson", "rmse", "mse", "amplitude ratio", "energy residual", "relative error"] = Field(
        description="What is computed; the last two need no reference curve."
    )
    reading: Label = Field("all", description="Reading by name, or all.")
    against: Label | None = Field(None, description="Label of the reference curve.")
    on: Literal["points", "curve"] = Field(
        "points", description="Compare the simulated points, or the processed curve; both normalised."
    )
    band_nm: tuple[Wavelength, Wavelength] | None = Field(
        None, strict=False, description="First and last wavelength compared; all if not said."
    )

    @property
    def aim(self) -> Wanted:
        """What it wants."""
        return self.aims(self.metric)

    @property
    def needs_reference(self) -> bool:
        """Whether it compares with a curve."""
        return self.metric not in ("energy residual", "relative error")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.needs_reference != (self.against is not None):
            bound = "needs the label of a reference" if self.needs_reference else "compares with no reference"
            raise InputError.of("against", self.against, f"{self.metric} {bound}", "Give it, or leave it out.")
        if self.band_nm is not None and not self.band_nm[0] < self.band_nm[1]:
            raise InputError.of("band_nm", self.band_nm, "must rise", "Give [first, last].")
        return self


class SpectralExperiment(Experiment):
    """A spectrum of a tissue, under one or more readings."""

    kind: Literal["spectral"] = "spectral"
    readings: tuple[ReadingName, ...] = Field((), strict=False, description="Named readings, as they stand.")
    tissue: TissueSpec = Field(default_factory=TissueSpec, description="What is looked at.")
    wavelengths: Wavelengths = Field(description="Where the spectrum is sampled.")
    instrument: Instrument = Field(description="What looks at it.")
    solver: Solver = Field(default_factory=WalkSolver, description="How light is followed, and how well.")
    accuracy: Accuracy | None = Field(
        None, description="What the result is to be worth; for solver.kind = 'auto', which it implies."
    )
    effects: EffectsConfig | None = Field(
        None, description="Which effects are simulated: 'auto', or a table; every one if not said."
    )
    variant: Literal["llvm", "cuda"] = Field("llvm", description="Where a walk runs: processor or graphics card.")
    processing: Processing = Field(default_factory=Processing, description="What is done to the curves.")
    reading: tuple[Reading, ...] = Field((), strict=False, description="Further readings, with options of their own.")
    reference: tuple[Reference, ...] = Field((), strict=False, description="Measured curves to compare with.")
    criterion: tuple[CriterionSpec, ...] = Field((), strict=False, description="Claims to judge.")
    bench: Label | None = Field(
        None, description="Reading about which the report has sliders; none if not said. Costs one more walk."
    )

    @property
    def all_readings(self) -> tuple[Reading, ...]:
        """The named readings, then those with options of their own."""
        return (*(READINGS[name] for name in self.readings), *self.reading)

    @model_validator(mode="before")
    @classmethod
    def _wish(cls, given: Any) -> Any:
        """A wish alone asks for the solver that can meet it; that solver without a wish has the default one."""
        if not isinstance(given, dict):
            return given
        solver, wish = given.get("solver"), given.get("accuracy")
        if solver is None and wish is not None:
            return {**given, "solver": {"kind": "auto"}}
        auto = solver.get("kind") == "auto" if isinstance(solver, dict) else getattr(solver, "is_auto", False)
        return {**given, "accuracy": DEFAULT_ACCURACY} if auto and wish is None else given

    @model_validator(mode="after")
    def _holds_together(self) -> Self:
        names = [r.name for r in self.all_readings]
        if not names:
            raise InputError.of(
                "readings", (), "at least one reading is needed", 'Write readings = ["consistent"], or a [[reading]].'
            )
        for name in names:
            if not name.isprintable() or name != name.strip():
                raise InputError.of("reading name", name, "must be one line of text", "Rename the reading.")
        _once("reading", names)
        if self.bench is not None:
            _known("bench", self.bench, names)
        labels = [r.label for r in self.reference]
        _once("reference", labels)
        for k, criterion in enumerate(self.criterion):
            _known(f"criterion[{k}].reading", criterion.reading, ["all", *names])
            if criterion.against is not None:
                _known(f"criterion[{k}].against", criterion.against, labels)
        _once("criterion", [name for _, _, name in self.claims()])
        if self.accuracy is not None and not self.solver.is_auto:
            raise InputError.of(
                "solver.kind",
                self.solver.kind,
                "has an accuracy of its own, so that [accuracy] would not rule",
                "Write solver.kind = 'auto', or leave [accuracy] out.",
            )
        if self.solver.own_seed is not None:
            raise InputError.of(
                "solver.seed", self.solver.own_seed, "an experiment has one seed", "Set `seed` at the top."
            )
        self.tissue.build()
        self._curves_can_be_made()
        return self

    def _curves_can_be_made(self) -> None:
        """What would only fail once the light has been followed."""
        from livlab.curves import regular_grid

        grid = self.wavelengths.grid()
        first, last = float(grid[0]), float(grid[-1])
        for k, criterion in enumerate(self.criterion):
            band = criterion.band_nm
            if band is not None and not first <= band[0] < band[1] <= last:
                raise InputError.of(
                    f"criterion[{k}].band_nm", band, f"must lie within {first:g}–{last:g} nm", "Narrow it."
                )
        if len(grid) < 2:
            return
        step, window = self.processing.interpolate_nm, self.processing.moving_average
        if (last - first) / step > MOST_CURVE_POINTS:
            raise InputError.of(
                "processing.interpolate_nm", step, f"makes more than {MOST_CURVE_POINTS} points", "Take a larger step."
            )
        try:
            size = len(regular_grid(first, last, step))
        except InputError:
            raise InputError.of(
                "processing.interpolate_nm", step, f"must divide the band {first:g}–{last:g} nm evenly", "Change it."
            ) from None
        if window > size:
            raise InputError.of(
                "processing.moving_average", window, f"must be at most {size}, the curve's points", "Narrow it."
            )

    def claims(self) -> list[tuple[CriterionSpec, str, str]]:
        """Each criterion with each reading it is asked of, and the claim's name."""
        every = [r.name for r in self.all_readings]
        return [
            (c, name, self._claim_name(c, name))
            for c in self.criterion
            for name in (every if c.reading == "all" else [c.reading])
        ]

    def resolve(self) -> Self:
        """With the tissue and every reading written out in full."""
        if not self.readings and self.tissue.inline is not None and not self.tissue.set:
            return self
        changes: dict[str, Any] = {"tissue": self.tissue.resolve(), "readings": (), "reading": self.all_readings}
        return self.model_copy(update=changes)

    def plain(self) -> dict[str, Any]:
        """As TOML's own types; the solver's seed is left out, since it follows from the experiment's."""
        plain = super().plain()
        plain["solver"].pop("seed", None)
        return plain

    def datasets(self) -> tuple[str, ...]:
        """Datasets of the tissue and of the references that are to be had, sorted."""
        from livlab import datasets

        there = set(datasets.names())
        references = {
            r.dataset for r in self.reference if r.dataset in there or r.dataset not in datasets.unavailable()
        }
        return tuple(sorted({*self.tissue.build().dataset_names(), *references}))

    def _claim_name(self, criterion: CriterionSpec, reading: str) -> str:
        from livlab.criteria import Criterion

        grid = self.wavelengths.grid()
        band = criterion.band_nm or (float(grid[0]), float(grid[-1]))
        against = criterion.against or _AGAINST[criterion.metric]
        name = Criterion(criterion.metric, reading, against, band_nm=band).name
        return name + (", processed curve" if criterion.on == "curve" else "")


_AGAINST = {"energy residual": "conservation", "relative error": "its maximum"}


def _once(what: str, names: list[str]) -> None:
    for name, count in Counter(names).items():
        if count > 1:
            raise InputError.of(what, name, "appears twice", "Give each its own name.")


def _known(field: str, value: str, known: list[str]) -> None:
    if value not in known:
        hint = nearest(value, known) or (f"Known: {', '.join(known)}." if known else "Add a [[reference]].")
        raise InputError.of(field, value, "names none that there is", hint)
