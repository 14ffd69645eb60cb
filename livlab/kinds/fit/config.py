"""The fit experiment: tissue parameters from measured curves, then checked on curves and bands it did not see."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
from livlab.acquire.instruments.models import Instrument
from livlab.config.errors import nearest
from livlab.config.schema import Experiment, Label, Section
from livlab.criteria import Wanted
from livlab.errors import InputError
from livlab.kinds.fit.config_alternative import Alternative, has, lacking
from livlab.kinds.fit.config_parameter import FitParameter, Positive
from livlab.kinds.shared.criterion import Judged
from livlab.kinds.shared.sections import Wavelength, Wavelengths
from livlab.model.tissue.presets import TissueSpec
from livlab.model.tissue.readings import READINGS, Reading
from livlab.optimise.algorithms import ALGORITHMS

if TYPE_CHECKING:
    from livlab.kinds.fit.room import Room


class Measurement(Section):
    """A measured curve, to fit or to check the fit on."""

    label: Label = Field(description="How claims and the report call it, e.g. human liver.")
    dataset: str = Field(min_length=1, description="Dataset by name (`livlab data list`, `livlab data add`).")
    column: str = Field("reflectance", min_length=1, description="Column with the curve.")
    sd_column: str | None = Field(None, description="Column with its standard deviation.")
    subjects: Annotated[int, Field(ge=1)] = Field(1, description="Subjects behind the mean: σ is SD/√subjects.")
    sd: Positive | None = Field(None, description="Standard deviation of every point, where there is no column.")
    relative_sd: Positive | None = Field(None, description="The same as a share of the curve.")
    band_nm: tuple[Wavelength, Wavelength] | None = Field(
        None, strict=False, description="First and last wavelength compared; all that both have if not said."
    )
    role: Literal["fit", "check"] = Field("fit", description="Whether the fit sees it.")
    scaling: Literal["max", "sum", "none", "free"] = Field(
        "max", description="Both curves over their maximum or sum, as they are, or the model times the best factor."
    )
    loss: Literal["rmse", "chi2", "pearson", "colour"] = Field(
        "rmse", description="Mean square, squares over σ², 1 − Pearson, or CIEDE2000 (D65, 2°) squared."
    )
    weight: Positive = Field(1.0, description="How much it counts beside other measurements.")
    set: dict[str, Any] = Field({}, description="Values by path in which the tissue measured here differs.")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.band_nm is not None and not self.band_nm[0] < self.band_nm[1]:
            raise InputError.of("band_nm", self.band_nm, "must rise", "Give [first, last].")
        given = [k for k in ("sd_column", "sd", "relative_sd") if getattr(self, k) is not None]
        if len(given) > 1:
            raise InputError.of("measurement", " and ".join(given), "only one can say the error", "Drop the others.")
        if self.loss == "chi2" and not given:
            raise InputError.of(
                "loss", "chi2", "needs a standard deviation", "Give sd_column, sd or relative_sd, or use loss = 'rmse'."
            )
        return self


class Search(Section):
    """How the optimum is sought."""

    algorithm: tuple[str, ...] = Field(
        ("auto",), strict=False, min_length=1, description="NLopt algorithms, global before local; or auto (LD_SLSQP)."
    )
    starts: Annotated[int, Field(ge=1, le=1000)] = Field(1, description="Starts: the given one, then Sobol points.")
    max_evaluations: Annotated[int, Field(ge=1)] | None = Field(None, description="Evaluations of one search.")
    max_seconds: Positive = Field(600.0, description="Seconds of all searches.")
    standard_error: Annotated[float, Field(ge=1e-6, le=0.1)] = Field(
        1e-3, description="Of the total reflectance in the recorded walk."
    )
    most_recordings: Annotated[int, Field(ge=2, le=50)] = Field(5, description="Walks with fresh draws, at most.")

    @model_validator(mode="after")
    def _known(self) -> Self:
        for name in self.algorithm:
            if name != "auto" and name not in ALGORITHMS:
                hint = nearest(name, ALGORITHMS) or f"Known: auto, {', '.join(ALGORITHMS)}."
                raise InputError.of("algorithm", name, "is none that there is", hint)
        if "auto" in self.algorithm and len(self.algorithm) > 1:
            raise InputError.of("algorithm", self.algorithm, "auto stands alone", "Name all stages, or none.")
        return self


class RoundTrip(Section):
    """Tissues drawn by chance, simulated with noise and fitted, to count how often the intervals hold the truth."""

    tissues: Annotated[int, Field(ge=2, le=10_000)] = Field(50, description="Tissues drawn between the bounds.")
    relative_sd: Positive | None = Field(
        None, description="Noise as a share of the curve; that of each measurement's own error if not said."
    )
    standard_error: Annotated[float, Field(ge=1e-6, le=0.1)] = Field(
        2e-3, description="Of the total reflectance in its walks; counted in what the intervals claim."
    )


class FitCriterion(Judged):
    """A claim to judge."""

    metric: Literal["pearson", "rmse", "colour difference", "settled", "coverage"] = Field(
        description="Of a measurement's curves as they are compared; settled: 1 where fresh draws gave the same "
        "parameters; coverage: share of the round trips' intervals that hold the truth."
    )
    of: Label | None = Field(None, description="Label of the measurement.")

    @property
    def aim(self) -> Wanted:
        """What it wants."""
        return self.aims(self.metric)

    @property
    def name(self) -> str:
        """The claim's name."""
        if self.of:
            return f"{self.metric} fit vs {self.of}"
        return "fit settled under fresh draws" if self.metric == "settled" else "coverage of round trips"

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if (self.metric in ("settled", "coverage")) != (self.of is None):
            raise InputError.of("of", self.of, f"metric {self.metric!r} does not go with it", "Give or drop it.")
        return self


AS_GIVEN = "as given"
"""What the model of the file itself is called beside its alternatives."""


@dataclass(frozen=True)
class Scene:
    """A tissue that was measured: by which measurements, what is set in it, and which parameter each path follows."""

    labels: tuple[str, ...]
    set: dict[str, Any]
    keys: dict[str, str]


class FitExperiment(Experiment):
    """Tissue parameters fitted to measured curves."""

    kind: Literal["fit"] = "fit"
    tissue: TissueSpec = Field(default_factory=TissueSpec, description="The tissue, with what is not fitted.")
    reading: Reading = Field(default=READINGS["measured"], description="How the tissue is read.")
    wavelengths: Wavelengths = Field(description="Where the model is compared; bands are parts of it.")
    instrument: Instrument = Field(
        default=HyperspectralCamera(polarisation="crossed"), description="What saw the measured curves."
    )
    parameter: tuple[FitParameter, ...] = Field(
        strict=False, min_length=1, max_length=30, description="What is sought."
    )
    measurement: tuple[Measurement, ...] = Field(strict=False, min_length=1, description="What it is sought from.")
    alternative: tuple[Alternative, ...] = Field(
        (), strict=False, max_length=20, description="Other models to fit as well, and weigh against this one."
    )
    weigh_by: Literal["aic", "bic"] = Field("aic", description="Criterion that weighs the models (Akaike, Schwarz).")
    search: Search = Field(default_factory=Search, description="How.")
    level: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(0.95, description="Coverage of the intervals.")
    round_trip: RoundTrip | None = Field(None, description="Whether to test the intervals on simulated tissues.")
    variant: Literal["llvm", "cuda"] = Field("llvm", description="Where it walks.")
    bench: bool = Field(True, description="Whether the report has sliders about the fitted tissue; costs one walk.")
    criterion: tuple[FitCriterion, ...] = Field((), strict=False, description="Claims to judge.")

    @model_validator(mode="after")
    def _holds_together(self) -> Self:
        self.check()
        return self

    def check(self) -> None:
        """Whether it holds together.

        Raises
        ------
        InputError
            It does not.
        """
        for what, names in (
            ("parameter", [p.name for p in self.parameter]),
            ("measurement", [m.label for m in self.measurement]),
            ("criterion", [c.name for c in self.criterion]),
            ("alternative", [AS_GIVEN, *(a.name for a in self.alternative)]),
        ):
            twice = next((x for x in names if names.count(x) > 1), None)
            if twice is not None:
                raise InputError.of(what, twice, "appears twice", "Give each its own.")
        if not any(m.role == "fit" for m in self.measurement):
            raise InputError.of("measurement.role", "check", "none is to be fitted", "Give one role = 'fit'.")
        labels = [m.label for m in self.measurement]
        for k, criterion in enumerate(self.criterion):
            if criterion.of is not None and criterion.of not in labels:
                hint = nearest(criterion.of, labels) or f"Known: {', '.join(labels)}."
                raise InputError.of(f"criterion[{k}].of", criterion.of, "names no measurement", hint)
        self._belongs(labels)
        grid = self.wavelengths.grid()
        for m in self.measurement:
            if m.band_nm is not None and not (m.band_nm[0] <= grid[-1] and m.band_nm[1] >= grid[0]):
                raise InputError.of(
                    f"measurement {m.label}.band_nm", m.band_nm, f"lies outside {grid[0]:g}–{grid[-1]:g} nm", "Move it."
                )
        self.room().check_start()
        for alternative in self.alternative:
            self.version(alternative)

    def _belongs(self, labels: list[str]) -> None:
        for p in self.parameter:
            for label in p.only or ():
                if label not in labels:
                    hint = nearest(label, labels) or f"Known: {', '.join(labels)}."
                    raise InputError.of(f"parameter {p.name}.only", label, "names no measurement", hint)
        for m in self.measurement:
            paths = [p.path for p in self.parameter if p.only is None or m.label in p.only]
            twice = next((x for x in paths if paths.count(x) > 1), None)
            if twice is not None:
                bound = f"two parameters move it in the tissue of {m.label}"
                raise InputError.of("parameter.path", twice, bound, "Say with only = [...] whose each is, or drop one.")
            clash = next((x for x in m.set if x in paths), None)
            if clash is not None:
                bound = "is a parameter of this tissue, too"
                raise InputError.of(f"measurement {m.label}.set", clash, bound, "Set it, or fit it.")
        if any(c.metric == "coverage" for c in self.criterion) and self.round_trip is None:
            raise InputError.of("criterion.metric", "coverage", "needs round trips", "Add [round_trip].")
        if self.round_trip is not None:
            for m in self.measurement:
                if m.role == "fit" and m.loss != "chi2":
                    bound = "says no likelihood, so that no interval can be tested by round trips"
                    raise InputError.of(
                        f"measurement {m.label}.loss", m.loss, bound, "Use loss = 'chi2' with a standard deviation."
                    )

    def scenes(self) -> list[Scene]:
        """The different tissues that were measured; most fits have one."""
        found: dict[tuple[object, ...], Scene] = {}
        for m in self.measurement:
            keys = {p.path: p.key for p in self.parameter if p.only is None or m.label in p.only}
            same = (repr(sorted(m.set.items())), *sorted(keys.items()))
            known = found.get(same)
            labels = (*known.labels, m.label) if known else (m.label,)
            found[same] = Scene(labels, dict(m.set), keys)
        return list(found.values())

    def version(self, alternative: Alternative) -> tuple[FitExperiment, list[str]]:
        """The fit of another model, and what it lacks: the same measurements, and the parameters that it has.

        Raises
        ------
        InputError
            A model that cannot be fitted, told with its name.
        """
        try:
            tissue = alternative.tissue(self.tissue)
            kept, said = lacking(tissue, self.parameter, alternative)
            measured = [m.model_copy(update={"set": {p: v for p, v in m.set.items() if has(tissue, p)}})
                        for m in self.measurement]  # fmt: skip
            lost = [p for m in self.measurement for p in m.set if not has(tissue, p)]
            said += [f"has no {path}, which measurements set" for path in dict.fromkeys(lost)]
            made = self.model_copy(
                update={
                    "tissue": TissueSpec(inline=tissue),
                    "reading": alternative.reading or self.reading,
                    "parameter": (*kept, *alternative.parameter),
                    "measurement": tuple(measured),
                    "alternative": (),
                    "criterion": (),
                    "round_trip": None,
                }
            )
            if not made.parameter:
                raise InputError.of("parameter", "none", "nothing is left to fit", "Give it parameters of its own.")
            made.check()
        except InputError as error:
            raise InputError(f"alternative {alternative.name}: {error.message}", remedy=error.remedy) from None
        return made, said

    def room(self) -> Room:
        """The tissues that the parameters make."""
        from livlab.kinds.fit.room import Room
        from livlab.optimise.parameters import ParameterSpace

        scenes = [(scene.set, scene.keys) for scene in self.scenes()]
        space = ParameterSpace(self.parameters())
        return Room(self.tissue.build(), self.reading, scenes, space, self.labels(), self.seed)

    def parameters(self) -> list[Any]:
        """As `livlab.optimise` takes them, by key.

        Raises
        ------
        InputError
            A tie to a label that there is none of.
        """
        paths = {p.name: p.key for p in self.parameter}
        for p in self.parameter:
            if p.tied is not None and p.tied not in paths:
                hint = nearest(p.tied, paths) or f"Known: {', '.join(paths)}."
                raise InputError.of(f"parameter {p.name}.tied", p.tied, "names no parameter", hint)
        return [p.parameter(paths[p.tied] if p.tied is not None else None) for p in self.parameter]

    def labels(self) -> dict[str, str]:
        """Name of each parameter by key."""
        return {p.key: p.name for p in self.parameter}

    def resolve(self) -> Self:
        """With the tissue written out in full."""
        if self.tissue.inline is not None and not self.tissue.set:
            return self
        made = tuple(a.resolve(self.tissue) for a in self.alternative)
        return self.model_copy(update={"tissue": self.tissue.resolve(), "alternative": made})

    def datasets(self) -> tuple[str, ...]:
        """Datasets of the tissue and of the measurements that are to be had, sorted."""
        from livlab import datasets

        there, missing = set(datasets.names()), datasets.unavailable()
        found = {m.dataset for m in self.measurement if m.dataset in there or m.dataset not in missing}
        tissues = [self.tissue.build(), *(a.tissue(self.tissue) for a in self.alternative)]
        return tuple(sorted({*(name for tissue in tissues for name in tissue.dataset_names()), *found}))


__all__ = [
    "AS_GIVEN",
    "Alternative",
    "FitCriterion",
    "FitExperiment",
    "FitParameter",
    "Measurement",
    "RoundTrip",
    "Scene",
    "Search",
]
