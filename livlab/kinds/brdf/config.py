"""The BRDF experiment: spheres of known materials, or of liver, photographed in a virtual rig and read as a BRDF."""

from __future__ import annotations

import math
import re
from collections import Counter
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from livlab.config.errors import nearest
from livlab.config.schema import Experiment, Label, Section
from livlab.criteria import Wanted
from livlab.errors import InputError
from livlab.kinds.shared.criterion import Judged
from livlab.kinds.shared.sections import Wavelengths
from livlab.model.tissue.presets import TissueSpec
from livlab.model.tissue.readings import READINGS, Reading, ReadingName

if TYPE_CHECKING:
    from livlab.acquire.instruments.goniometer import Detectors
    from livlab.acquire.instruments.sphere_rig import SphereRig

Angle = Annotated[float, Field(ge=0.0, lt=90.0)]
Place = Annotated[tuple[float, float], Field(strict=False)]
REFERENCE = "nunes2017_brdf"
"""Dataset of the measured BRDF that the thesis compares with; nobody has it as numbers until a user adds it."""


class RigLights(Section):
    """Where the lights stand; angles are counted from the direction sphere to camera."""

    layout: Literal["arc", "ring", "list"] = Field("arc", description="An arc over angles, a ring at one, or a list.")
    count: int = Field(8, ge=1, le=1000, description="How many; the thesis took 8.")
    first_deg: float = Field(10.0, ge=0.0, le=170.0, description="arc: first angle.")
    last_deg: float = Field(130.0, ge=0.0, le=170.0, description="arc: last angle.")
    azimuth_deg: float = Field(0.0, description="arc: its azimuth about the camera's axis, 0 to the camera's right.")
    angle_deg: float = Field(45.0, ge=0.0, le=170.0, description="ring: its angle.")
    list_deg: tuple[Place, ...] = Field((), strict=False, description="list: [angle, azimuth] of each.")
    distance_radii: float | Literal["infinite"] = Field(
        10.0, description="Distance from the sphere's centre in radii, or 'infinite'; a tissue's lights are infinite."
    )
    half_angle_deg: float = Field(
        5.0, gt=0.0, lt=30.0, description="Tissue: half-angle of each light as the sphere sees it."
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if (self.layout == "list") != bool(self.list_deg):
            raise InputError.of("list_deg", self.list_deg, f"does not go with layout {self.layout!r}", "Give one.")
        if not isinstance(self.distance_radii, str) and not self.distance_radii > 1:
            raise InputError.of("distance_radii", self.distance_radii, "must be > 1", "Move the lights out.")
        return self

    @property
    def number(self) -> int:
        """How many lights."""
        return len(self.list_deg) if self.layout == "list" else self.count


class RigSpec(Section):
    """A camera that looks at a sphere, and its lights."""

    radius_px: float = Field(115.0, ge=4.0, le=2000.0, description="Radius of the sphere's outline in pixels.")
    radius_mm: float = Field(25.0, gt=0.0, le=1e4, description="Radius of the sphere in mm.")
    camera_radii: float = Field(10.0, gt=1.0, le=1e6, description="Distance of the camera in radii.")
    projection: Literal["perspective", "orthographic"] = Field("perspective", description="Of the camera.")
    samples_per_pixel: int = Field(16, ge=1, le=1 << 20, description="Stratified samples a pixel and light.")
    silhouette: Literal["all-round", "back-lit"] = Field("back-lit", description="Frame that shows the outline.")
    lights: RigLights = Field(default_factory=RigLights, description="The lights.")

    def build(self, channels: int = 3) -> SphereRig:
        """The rig."""
        from livlab.acquire.instruments.sphere_rig import SphereRig, arc, light, ring

        spec = self.lights
        far = math.inf if isinstance(spec.distance_radii, str) else spec.distance_radii
        common: dict[str, Any] = {"distance_radii": far, "radius_mm": self.radius_mm, "channels": channels}
        if spec.layout == "arc":
            lights = arc(spec.count, first_deg=spec.first_deg, last_deg=spec.last_deg, azimuth_deg=spec.azimuth_deg,
                         **common)  # fmt: skip
        elif spec.layout == "ring":
            lights = ring(spec.count, angle_deg=spec.angle_deg, **common)
        else:
            lights = tuple(light(a, b, **common) for a, b in spec.list_deg)
        return SphereRig.make(
            lights,
            radius_px=self.radius_px,
            radius_mm=self.radius_mm,
            camera_radii=self.camera_radii,
            orthographic=self.projection == "orthographic",
            samples_per_pixel=self.samples_per_pixel,
            silhouette=self.silhouette,
        )


class FitSpec(Section):
    """What is fitted to the samples."""

    model: str = Field("lambert", min_length=1, description="A lobe, a named sum, or lobes joined by + (ggx+lambert).")
    loss: Literal["cosine-weighted-l2", "log", "cube-root", "chi2"] = Field(
        "cosine-weighted-l2", description="What is made small; a fitted parameter depends on it."
    )
    footprint: bool = Field(True, description="Average the model over each pixel's footprint.")
    fixed: dict[str, float | list[float]] = Field({}, description="Parameters held at a value, or one a channel.")
    free: tuple[str, ...] = Field((), strict=False, description="Parameters to fit that are held unless freed.")
    starts: int = Field(2, ge=1, le=100, description="Starts of the search.")


def _types(table: Any) -> list[Any]:
    """Every `type` in a table of tables."""
    if isinstance(table, list):
        return [name for inner in table for name in _types(inner)]
    if not isinstance(table, dict):
        return []
    own = [table["type"]] if "type" in table else []
    return own + [name for inner in table.values() for name in _types(inner)]


class MaterialSpec(Section):
    """A material whose BRDF is known."""

    name: Label = Field(description="How criteria and reports call it.")
    bsdf: dict[str, Any] = Field(description="Any opaque Mitsuba BSDF as a table, its `type` first.")
    fit: FitSpec | None = Field(None, description="What is fitted; nothing if not said.")
    true: dict[str, float] = Field({}, description="The fitted model's parameters as the material has them.")

    @model_validator(mode="after")
    def _typed(self) -> Self:
        if not isinstance(self.bsdf.get("type"), str):
            raise InputError.of("bsdf.type", self.bsdf.get("type"), "must name a Mitsuba BSDF", "Write it.")
        for name in _types(self.bsdf):
            # Mitsuba looks a plugin's library up by its type: a path in it would load a library from anywhere.
            if not isinstance(name, str) or not re.fullmatch("[a-z][a-z0-9_]{0,63}", name):
                raise InputError.of("bsdf.type", name, "must be a plugin's plain name", "E.g. roughconductor.")
        if self.true and self.fit is None:
            raise InputError.of("true", self.true, "nothing is fitted", "Add a fit.")
        return self


class GoniometerSpec(Section):
    """The flat sample's detectors and photons."""

    theta_step_deg: float = Field(5.0, gt=0.0, le=90.0, description="Polar step of the detectors.")
    phi_step_deg: float = Field(30.0, gt=0.0, le=180.0, description="Azimuthal step of the detectors.")
    samples: int = Field(2_000_000, ge=1000, le=10**10, description="Photons a wavelength and angle of incidence.")

    def detectors(self) -> Detectors:
        """The detectors."""
        from livlab.acquire.instruments.goniometer import Detectors

        return Detectors(self.theta_step_deg, self.phi_step_deg)

    @model_validator(mode="after")
    def _tiles(self) -> Self:
        self.detectors()
        return self


class Scan(Section):
    """Which cut through the BRDF is compared: one incidence over exit angles, or light and eye together."""

    kind: Literal["incidence", "collinear"] = Field("incidence", description="Thesis: Fig. 7.4, or Fig. 7.5.")
    incidence_deg: Angle = Field(45.0, description="incidence: angle of the light.")
    last_deg: Annotated[float, Field(gt=0.0, lt=90.0)] = Field(75.0, description="Largest angle compared.")
    step_deg: Annotated[float, Field(gt=0.0, le=45.0)] = Field(
        5.0, description="Step of the angles compared, a multiple of the detectors' polar step."
    )
    width_deg: Annotated[float, Field(gt=0.0, le=20.0)] = Field(
        2.5, description="Half-width in θ_i (and collinear: in the angle between light and eye) of samples taken in."
    )


class BrdfCriterion(Judged):
    """A claim to judge; a tolerance alone is one about 0."""

    metric: Literal["relative rms", "parameter error", "seconds", "rmse", "mse", "pearson", "relative difference"] = (
        Field(description="What is computed.")
    )
    of: Label = Field("all", description="Material or reading by name, or all.")
    pose: Literal["known", "outline"] = Field("known", description="Pose of the sphere: as set, or by the outline.")
    parameter: str | None = Field(None, description="parameter error: which; relative to the true value.")
    against: Literal["goniometer", "fit", "nunes2017", "truth"] = Field("truth", description="What it is held against.")
    wavelength_nm: float | None = Field(None, gt=0, description="Tissue: one wavelength; all together if not said.")

    @model_validator(mode="before")
    @classmethod
    def _about_zero(cls, given: Any) -> Any:
        alone = isinstance(given, dict) and "tolerance" in given and "reference" not in given
        return {**given, "reference": 0.0} if alone else given

    @property
    def aim(self) -> Wanted:
        """What it wants; only what was measured of liver is no check of livlab itself."""
        return self.aims(self.metric, None if self.against == "nunes2017" else "checks")


class BrdfExperiment(Experiment):
    """A BRDF from pictures of a sphere."""

    kind: Literal["brdf"]
    rig: RigSpec = Field(default_factory=RigSpec, description="Camera, lights and sphere.")
    material: tuple[MaterialSpec, ...] = Field((), strict=False, description="Materials whose BRDF is known.")
    tissue: TissueSpec | None = Field(None, description="A tissue as the sphere's material, in place of materials.")
    readings: tuple[ReadingName, ...] = Field((), strict=False, description="Named readings of the tissue.")
    reading: tuple[Reading, ...] = Field((), strict=False, description="Further readings, with options of their own.")
    wavelengths: Wavelengths | None = Field(None, description="Where the tissue is looked at.")
    radii_mm: tuple[Annotated[float, Field(gt=0)], ...] = Field(
        (), strict=False, description="Tissue: other radii of the sphere to compare."
    )
    scan: Scan = Field(default_factory=Scan, description="The cut that is compared.")
    goniometer: GoniometerSpec = Field(default_factory=GoniometerSpec, description="The flat sample's instrument.")
    fit: FitSpec | None = Field(None, description="Tissue: what is fitted to the sphere's samples.")
    max_angle_deg: Annotated[float, Field(gt=0.0, lt=90.0)] = Field(80.0, description="Samples beyond are left out.")
    lobes_deg: tuple[Angle, ...] = Field(
        (0.0, 30.0, 45.0, 60.0, 75.0), strict=False, min_length=1, description="Angles of incidence drawn."
    )
    variant: Literal["llvm", "cuda"] = Field("llvm", description="Where walks run: processor or graphics card.")
    criterion: tuple[BrdfCriterion, ...] = Field((), strict=False, description="Claims to judge.")

    @property
    def all_readings(self) -> tuple[Reading, ...]:
        """The named readings, then those with options of their own."""
        return (*(READINGS[name] for name in self.readings), *self.reading)

    @model_validator(mode="after")
    def _holds_together(self) -> Self:
        if bool(self.material) == (self.tissue is not None):
            raise InputError.of(
                "material", len(self.material), "needs one [[material]] or more, or a [tissue], not both", "Give one."
            )
        if self.tissue is not None:
            if self.wavelengths is None or not self.all_readings:
                raise InputError.of("tissue", "…", "needs readings and [wavelengths]", "Add them.")
            if self.rig.lights.distance_radii != "infinite":
                raise InputError.of(
                    "rig.lights.distance_radii",
                    self.rig.lights.distance_radii,
                    "a tissue's lights are distant",
                    'Write distance_radii = "infinite".',
                )
            self.tissue.build()
        names = [m.name for m in self.material] or [r.name for r in self.all_readings]
        for name, count in Counter(names).items():
            if count > 1:
                raise InputError.of("name", name, "appears twice", "Give each its own name.")
        for k, criterion in enumerate(self.criterion):
            if criterion.of not in ("all", *names):
                hint = nearest(criterion.of, names) or f"Known: {', '.join(names)}."
                raise InputError.of(f"criterion[{k}].of", criterion.of, "names none that there is", hint)
            known = () if self.wavelengths is None else self.wavelengths.grid().tolist()
            if criterion.wavelength_nm is not None and criterion.wavelength_nm not in known:
                raise InputError.of(
                    f"criterion[{k}].wavelength_nm", criterion.wavelength_nm, "is not looked at", f"Known: {known}."
                )
            if (criterion.metric == "parameter error") != (criterion.parameter is not None):
                raise InputError.of(
                    f"criterion[{k}].parameter", criterion.parameter, "goes with 'parameter error' alone", "Mend it."
                )
        steps = self.scan.step_deg / self.goniometer.theta_step_deg
        if not math.isclose(steps, round(steps), abs_tol=1e-9) or steps < 1:
            raise InputError.of(
                "scan.step_deg", self.scan.step_deg, "must be a multiple of goniometer.theta_step_deg", "Change one."
            )
        places = {*self.lobes_deg, *([self.scan.incidence_deg] if self.scan.kind == "incidence" else [])}
        for angle in places if self.tissue is not None else ():
            off = angle / self.goniometer.theta_step_deg
            if not math.isclose(off, round(off), abs_tol=1e-9):
                raise InputError.of("lobes_deg", angle, "must be a multiple of goniometer.theta_step_deg", "Change it.")
        self.rig.build()
        return self

    def resolve(self) -> Self:
        """With the tissue and every reading written out in full."""
        if self.tissue is None or (not self.readings and self.tissue.inline is not None and not self.tissue.set):
            return self
        changes: dict[str, Any] = {"tissue": self.tissue.resolve(), "readings": (), "reading": self.all_readings}
        return self.model_copy(update=changes)

    def datasets(self) -> tuple[str, ...]:
        """Datasets of the tissue, and the measured BRDF where a user has added it, sorted."""
        from livlab import datasets

        if self.tissue is None:
            return ()
        own = {REFERENCE} & set(datasets.names())
        return tuple(sorted({*self.tissue.build().dataset_names(), *own}))
