"""The picture experiment: a body of tissue before a camera, under one or more readings, in colour.

What it says of the scene lives in `livlab.kinds.picture.config_scene`.
"""

from __future__ import annotations

from collections import Counter
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from livlab.config.errors import nearest
from livlab.config.schema import Experiment, Label, Section
from livlab.criteria import Group, Wanted, wanted
from livlab.criteria.limits import within
from livlab.effects.config import EffectsConfig
from livlab.errors import InputError
from livlab.kinds.picture.config_scene import CameraSpec, Geometry, LightSpec, ObjectSpec, resolved_files
from livlab.kinds.shared.criterion import GROUP
from livlab.kinds.shared.sections import Wavelengths
from livlab.model.tissue.presets import TissueSpec
from livlab.model.tissue.readings import READINGS, Reading, ReadingName

Route = Literal["thesis", "stochastic", "cie"]
BaselineName = Literal["lambert", "blinn-phong", "ashikhmin-shirley", "dipole"]
Observer = Literal["cie-1931-2", "cie-1964-10", "cie-2015-2", "cie-2015-10"]
Illuminant = Literal[
    "A", "D50", "D65", "E", "FL2", "FL7", "FL11", "LED-B1", "LED-B2", "LED-B3", "LED-B4", "LED-B5", "LED-BH1",
    "LED-RGB1", "LED-V1", "xenon",
]  # fmt: skip
BASELINES: tuple[BaselineName, ...] = ("lambert", "blinn-phong", "ashikhmin-shirley", "dipole")

LARGEST_SUMS_BYTES = 3 << 30
"""Two float64 sums a pixel and wavelength stay in memory; beyond this the picture is refused."""


class Colour(Section):
    """From spectra to colour: the three routes, shown side by side, and how bright the picture is."""

    routes: tuple[Route, ...] = Field(
        ("thesis",),
        strict=False,
        min_length=1,
        description="thesis: eq. 6.20, regular wavelengths around each primary; stochastic: random ones there; "
        "cie: the standard observer over a band. The first is the picture's own.",
    )
    kappa_nm: float = Field(20.0, ge=0.0, le=60.0, description="Half-width κ around 700, 546.1 and 435.8 nm.")
    count: int = Field(5, ge=1, le=100, description="Wavelengths N in each channel.")
    band: Wavelengths = Field(
        default_factory=lambda: Wavelengths.model_validate({"start_nm": 400.0, "stop_nm": 720.0, "step_nm": 20.0}),
        description="Wavelengths of the cie route.",
    )
    illuminant: Illuminant = Field("D65", description="Illuminant of the cie route; a white diffuser comes out white.")
    observer: Observer = Field("cie-1931-2", description="Observer of the cie route.")
    exposure: float = Field(
        1.0,
        gt=0.0,
        le=1000.0,
        description="Factor on the light before it is encoded: at 1 a white diffuser of level 1 is just white.",
    )

    @model_validator(mode="after")
    def _once(self) -> Self:
        _unique("routes", list(self.routes))
        if "thesis" in self.routes and self.count > 1 and not self.kappa_nm > 0:
            raise InputError.of("kappa_nm", self.kappa_nm, f"must be > 0 for {self.count} wavelengths", "Raise it.")
        return self


class Sampling(Section):
    """Samples, estimator and variant of a picture."""

    spp: int = Field(128, ge=1, le=10**7, description="Samples a pixel; with [accuracy] the most that are taken.")
    pass_spp: int = Field(8, ge=1, le=512, description="Samples a pixel between two looks at the clock and Ctrl-C.")
    estimator: Literal["expected", "analog"] = Field(
        "expected",
        description="Absorption as a weight (all wavelengths on one path), or as a path's end (Algorithm 1).",
    )
    variant: Literal["llvm", "cuda"] = Field("llvm", description="Where it runs: processor or graphics card.")


class PictureAccuracy(Section):
    """When a picture is good enough; exactly one rules."""

    relative: float | None = Field(
        None,
        gt=0.0,
        lt=1.0,
        description="Median over the lit body's pixels of a pixel's relative standard error: its mean standard error "
        "over its mean radiance, over the wavelengths.",
    )
    seconds: float | None = Field(None, gt=0.0, le=1e6, description="Time that each picture may take.")

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.relative is None) == (self.seconds is None):
            raise InputError.of(
                "accuracy",
                self.model_dump(),
                "needs exactly one of relative and seconds",
                "Write relative = 0.02, say.",
            )
        return self


class Compared(Section):
    """Another tissue in the same scene, light and exposure, to compare the picture's own with."""

    name: Label = Field(description="How criteria and reports call it, e.g. healthy.")
    tissue: TissueSpec = Field(description="What it is.")


class CostStudy(Section):
    """Image error against time, on a small copy of the picture: what each way of following light costs."""

    width: int = Field(64, ge=4, le=512, description="Pixels across; the height follows.")
    spp: tuple[Annotated[int, Field(ge=2, le=4096)], ...] = Field(
        (4, 16, 64), strict=False, min_length=1, description="Samples a pixel tried, rising."
    )
    reading: Label | None = Field(None, description="Reading by name; the first if not said.")
    ways: tuple[Literal["together", "one by one", "analog", "planned"], ...] = Field(
        ("together", "one by one", "analog", "planned"),
        strict=False,
        min_length=1,
        description="together: expected absorption, one path for all wavelengths; one by one: expected, a path each; "
        "analog: absorption ends a path, a path each; planned: together, without the effects that the scene does not "
        "call for.",
    )

    @model_validator(mode="after")
    def _rises(self) -> Self:
        if list(self.spp) != sorted(set(self.spp)):
            raise InputError.of("spp", self.spp, "must rise", "Sort them, each once.")
        _unique("ways", list(self.ways))
        return self


Metric = Literal[
    "lightness",
    "chroma",
    "hue",
    "lightness difference",
    "redness difference",
    "yellowness difference",
    "hue difference",
    "colour difference",
    "relative error",
    "seconds",
    "speed",
    "memory",
]


class PictureCriterion(Section):
    """A claim to judge: low ≤ value ≤ high, or one limit; one of `checks` unless it says otherwise.

    Colours are CIELAB of the mean colour of the lit body as the picture shows it. A difference is the picture's own
    tissue less the compared one's; `colour difference` is CIEDE2000 between two colour routes.
    """

    metric: Metric = Field(
        description="lightness L*, chroma C*, hue h in degrees; differences of L*, a* (redness), b* (yellowness) and "
        "h; colour difference ΔE00; relative error (median over the lit body); seconds; speed in samples a second, "
        "compiling apart; memory (GiB at its peak)."
    )
    reading: Label = Field("all", description="Reading by name, or all.")
    of: Label | None = Field(None, description="A compared tissue by name; the picture's own if not said.")
    against: Label | None = Field(None, description="A difference's other side: a compared tissue, or a colour route.")
    route: Route | None = Field(None, description="Colour route; the picture's own if not said.")
    within: tuple[float, float] | None = Field(None, strict=False, description="[low, high]: where it passes.")
    at_least: float | None = Field(None, description="Lower limit, in place of `within`.")
    at_most: float | None = Field(None, description="Upper limit, in place of `within`.")
    group: Group | None = Field(None, description=GROUP)
    source: str = Field("", max_length=400, description="Where the bounds are from.")

    @property
    def aim(self) -> Wanted:
        """What it wants."""
        group = self.group or "checks"
        if self.within is not None:
            return within(self.metric, *self.within, group=group)
        return wanted(self.metric, at_least=self.at_least, at_most=self.at_most, group=group)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.within is not None and not self.within[0] < self.within[1]:
            raise InputError.of("within", self.within, "must rise", "Give [low, high].")
        limits = {k: v for k in ("at_least", "at_most") if (v := getattr(self, k)) is not None}
        if (self.within is None) == (not limits):
            given = {"within": self.within, **limits}
            raise InputError.of("within", given, "goes with no other limit, and is needed without", "Give one form.")
        self.aim  # noqa: B018 - limits that do not rise are told here
        if self.metric.endswith("difference") != (self.against is not None):
            bound = "needs the other side" if self.against is None else "compares with nothing"
            raise InputError.of("against", self.against, f"{self.metric} {bound}", "Give it, or leave it out.")
        return self


class PictureExperiment(Experiment):
    """A body of tissue before a camera."""

    kind: Literal["picture"]
    readings: tuple[ReadingName, ...] = Field((), strict=False, description="Named readings, as they stand.")
    tissue: TissueSpec = Field(default_factory=TissueSpec, description="What the body is.")
    geometry: Geometry = Field(default_factory=Geometry, description="Its shape, and where its layers lie.")
    camera: CameraSpec = Field(description="What looks at it.")
    light: tuple[LightSpec, ...] = Field(strict=False, min_length=1, description="What lights it.")
    object: tuple[ObjectSpec, ...] = Field((), strict=False, description="Other bodies in the scene.")
    colour: Colour = Field(default_factory=Colour, description="From spectra to colour.")
    sampling: Sampling = Field(default_factory=Sampling, description="How light is followed, and how long.")
    accuracy: PictureAccuracy | None = Field(
        None, description="When a picture is good enough; `spp` alone if not said."
    )
    effects: EffectsConfig | None = Field(
        None,
        description="Which effects are simulated: 'auto', or a table; every one if not said. The plan is made for flat "
        "layers under a camera, since it knows plane layers only.",
    )
    baselines: tuple[BaselineName, ...] = Field(
        (), strict=False, description="Older models of appearance, shown beside the picture under the same light."
    )
    reading: tuple[Reading, ...] = Field((), strict=False, description="Further readings, with options of their own.")
    compared: tuple[Compared, ...] = Field((), strict=False, description="Other tissues in the same scene.")
    cost: CostStudy | None = Field(None, description="What each way of following light costs, on a small copy.")
    criterion: tuple[PictureCriterion, ...] = Field((), strict=False, description="Claims to judge.")

    @property
    def all_readings(self) -> tuple[Reading, ...]:
        """The named readings, then those with options of their own."""
        return (*(READINGS[name] for name in self.readings), *self.reading)

    @property
    def tissues(self) -> dict[str, TissueSpec]:
        """The picture's own tissue under the name "", then the compared ones."""
        return {"": self.tissue, **{c.name: c.tissue for c in self.compared}}

    @model_validator(mode="after")
    def _holds_together(self) -> Self:
        names = [r.name for r in self.all_readings]
        if not names:
            raise InputError.of(
                "readings", (), "at least one reading is needed", 'Write readings = ["thesis"], or a [[reading]].'
            )
        compared = [c.name for c in self.compared]
        for what, several in (
            ("reading", names),
            ("compared", compared),
            ("baselines", list(self.baselines)),
            ("object", [o.name for o in self.object]),
        ):
            _unique(what, several)
        for k, c in enumerate(self.criterion):
            here = f"criterion[{k}]"
            _known(f"{here}.reading", c.reading, ["all", *names])
            if c.of is not None:
                _known(f"{here}.of", c.of, compared)
            if c.route is not None:
                _known(f"{here}.route", c.route, list(self.colour.routes))
            if c.against is not None:
                others = [str(r) for r in self.colour.routes] if c.metric == "colour difference" else compared
                _known(f"{here}.against", c.against, others)
        _unique("criterion", [name for _, _, name in self.claims()])
        if self.cost is not None and self.cost.reading is not None:
            _known("cost.reading", self.cost.reading, names)
        for tissue in self.tissues.values():
            tissue.build()
        self._fits_in_memory()
        return self

    def _fits_in_memory(self) -> None:
        three = 3 * self.colour.count
        waves = sum(len(self.colour.band.grid()) if r == "cie" else three for r in self.colour.routes)
        wanted = 2 * 8 * self.camera.width * self.camera.height * waves
        if wanted > LARGEST_SUMS_BYTES:
            raise InputError.of(
                "camera",
                f"{self.camera.width} × {self.camera.height}, {waves} wavelengths",
                f"needs {wanted / 2**30:.1f} GiB for its sums, more than {LARGEST_SUMS_BYTES / 2**30:g} GiB",
                "Take fewer pixels or wavelengths.",
            )

    def claims(self) -> list[tuple[PictureCriterion, str, str]]:
        """Each criterion with each reading it is asked of, and the claim's name."""
        every = [r.name for r in self.all_readings]
        return [
            (c, name, _claim_name(c, name))
            for c in self.criterion
            for name in (every if c.reading == "all" else [c.reading])
        ]

    def resolve(self) -> Self:
        """With tissues, readings and the hashes of files written out in full."""
        changes: dict[str, Any] = {
            "tissue": self.tissue.resolve(),
            "compared": tuple(c.model_copy(update={"tissue": c.tissue.resolve()}) for c in self.compared),
            "geometry": resolved_files(self.geometry),
            "light": resolved_files(self.light),
            "readings": (),
            "reading": self.all_readings,
        }
        return self.model_copy(update=changes)

    def datasets(self) -> tuple[str, ...]:
        """Datasets of the tissues, sorted."""
        return tuple(sorted({n for t in self.tissues.values() for n in t.build().dataset_names()}))


def _claim_name(c: PictureCriterion, reading: str) -> str:
    about = f"{c.metric} {reading}"
    if c.of is not None:
        about += f", {c.of}"
    if c.against is not None:
        about += f" vs {c.against}"
    return about + (f" ({c.route} colour)" if c.route is not None else "")


def _unique(what: str, names: list[Any]) -> None:
    for name, count in Counter(names).items():
        if count > 1:
            raise InputError.of(what, name, "appears twice", "Give each its own name.")


def _known(field: str, value: str, known: list[str]) -> None:
    if value not in known:
        hint = nearest(value, known) or (f"Known: {', '.join(known)}." if known else "There is none to name.")
        raise InputError.of(field, value, "names none that there is", hint)
