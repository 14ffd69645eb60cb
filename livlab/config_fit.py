"""The fit experiment: tissue parameters from measured curves, then checked on curves and bands it did not see."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from livlab.acquire.instruments import HyperspectralCamera, Instrument
from livlab.config import Experiment, Label, Section, Text
from livlab.config_errors import nearest
from livlab.config_spectral import Wavelength, Wavelengths
from livlab.errors import InputError, LivlabError
from livlab.model.tissue.presets import TissueSpec
from livlab.model.tissue.readings import READINGS, Reading
from livlab.optimise.algorithms import ALGORITHMS

Positive = Annotated[float, Field(gt=0)]


class FitParameter(Section):
    """One parameter of a fit."""

    path: str = Field(min_length=1, description="Value of the tissue, e.g. layers.parenchyma.elements.blood.fraction.")
    label: Label | None = Field(None, description="How tables call it; the path's last words if not said.")
    unit: Text = Field("", description="Unit, for tables.")
    low: float = Field(description="Lower bound.")
    high: float = Field(description="Upper bound.")
    start: float | None = Field(None, description="First guess; the middle of the (transformed) bounds if not said.")
    transform: Literal["linear", "log", "logit"] = Field("linear", description="How the search sees it.")
    fixed: bool = Field(False, description="Keep it at its start.")
    tied: Label | None = Field(None, description="Label of the parameter that it follows.")
    factor: float = Field(1.0, description="Its value over that of the one it is tied to.")
    prior_mean: float | None = Field(None, description="Mean of what is known beforehand.")
    prior_sd: Positive | None = Field(None, description="Standard deviation of what is known beforehand.")

    @property
    def name(self) -> str:
        """Label, or the path's last two words."""
        return self.label or " ".join(self.path.split(".")[-2:]).replace("_", " ")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        self.parameter()
        return self

    def parameter(self, tied: str | None = None) -> Any:
        """As `livlab.optimise.Parameter`; `tied` is the path of the one it follows."""
        from livlab.optimise.parameters import Parameter

        return Parameter(
            self.path,
            self.low,
            self.high,
            self.start,
            self.transform,
            self.fixed,
            tied,
            self.factor,
            self.prior_mean,
            self.prior_sd,
        )


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


class FitCriterion(Section):
    """A claim to judge: |value − reference| ≤ tolerance."""

    metric: Literal["pearson", "rmse", "settled"] = Field(
        description="Of a measurement's normalised curves; settled: 1 where fresh draws gave the same parameters."
    )
    of: Label | None = Field(None, description="Label of the measurement.")
    reference: float = Field(description="Value expected.")
    tolerance: Annotated[float, Field(ge=0)] = Field(description="How far from it passes.")

    @property
    def name(self) -> str:
        """The claim's name."""
        return f"{self.metric} fit vs {self.of}" if self.of else "fit settled under fresh draws"

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if (self.metric == "settled") != (self.of is None):
            raise InputError.of("of", self.of, f"metric {self.metric!r} does not go with it", "Give or drop it.")
        return self


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
    search: Search = Field(default_factory=Search, description="How.")
    level: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(0.95, description="Coverage of the intervals.")
    profiles: bool = Field(False, description="Profile-likelihood intervals beside the normal ones; costs searches.")
    variant: Literal["llvm", "cuda"] = Field("llvm", description="Where it walks.")
    bench: bool = Field(True, description="Whether the report has sliders about the fitted tissue; costs one walk.")
    criterion: tuple[FitCriterion, ...] = Field((), strict=False, description="Claims to judge.")

    @model_validator(mode="after")
    def _holds_together(self) -> Self:
        for what, names in (
            ("parameter", [p.name for p in self.parameter]),
            ("parameter.path", [p.path for p in self.parameter]),
            ("measurement", [m.label for m in self.measurement]),
            ("criterion", [c.name for c in self.criterion]),
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
        grid = self.wavelengths.grid()
        for m in self.measurement:
            if m.band_nm is not None and not (m.band_nm[0] <= grid[-1] and m.band_nm[1] >= grid[0]):
                raise InputError.of(
                    f"measurement {m.label}.band_nm", m.band_nm, f"lies outside {grid[0]:g}–{grid[-1]:g} nm", "Move it."
                )
        self._tissue_holds()
        return self

    def _tissue_holds(self) -> None:
        from livlab.model.tissue.tissue import override
        from livlab.optimise.parameters import ParameterSpace

        space = ParameterSpace(self.parameters())
        start = space.values(space.vector({}))
        try:
            override(self.tissue.build(), start, by="fit")
        except LivlabError as error:
            raise InputError.of(
                "parameter",
                ", ".join(f"{p.name} = {start[p.path]:g}" for p in self.parameter),
                f"is no tissue at the start: {error.message}",
                error.remedy or "Mend the path or the start.",
            ) from None

    def parameters(self) -> list[Any]:
        """As `livlab.optimise` takes them, by path.

        Raises
        ------
        InputError
            A tie to a label that there is none of.
        """
        paths = {p.name: p.path for p in self.parameter}
        for p in self.parameter:
            if p.tied is not None and p.tied not in paths:
                hint = nearest(p.tied, paths) or f"Known: {', '.join(paths)}."
                raise InputError.of(f"parameter {p.name}.tied", p.tied, "names no parameter", hint)
        return [p.parameter(paths[p.tied] if p.tied is not None else None) for p in self.parameter]

    def labels(self) -> dict[str, str]:
        """Name of each parameter by path."""
        return {p.path: p.name for p in self.parameter}

    def resolve(self) -> Self:
        """With the tissue written out in full."""
        if self.tissue.inline is not None and not self.tissue.set:
            return self
        return self.model_copy(update={"tissue": self.tissue.resolve()})

    def datasets(self) -> tuple[str, ...]:
        """Datasets of the tissue and of the measurements that are to be had, sorted."""
        from livlab import datasets

        there, missing = set(datasets.names()), datasets.unavailable()
        found = {m.dataset for m in self.measurement if m.dataset in there or m.dataset not in missing}
        return tuple(sorted({*self.tissue.build().dataset_names(), *found}))


__all__ = ["FitCriterion", "FitExperiment", "FitParameter", "Measurement", "Search"]
