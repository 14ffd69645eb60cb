"""Virtual spectrometers and how their light is followed: what an experiment file says of them.

Every default that the literature does not fix is marked "assumed" in its description, which `livlab schema` shows.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from livlab.errors import InputError
from livlab.model.transport.accuracy import Accuracy

Extent = Annotated[float, Field(gt=0.0, le=1e4)] | Literal["infinite"]
"""A length in mm, or a sample that never ends sideways."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class Collinear(_Part):
    """Light and sensor along the normal over a square sample (Nunes 2019, Fig. 7.1).

    Reads the radiance factor: the flux that leaves the lit face within the sensor's cone, over sin²(acceptance)
    times the incident flux, so that a Lambertian of albedo ρ reads ρ at any acceptance. What leaves through the
    sample's sides is lost, and counted.
    """

    kind: Literal["collinear"] = "collinear"
    sample_side_mm: Extent = Field(10.0, description="Side of the square sample in mm, or 'infinite'; 1 cm² (thesis).")
    beam: Literal["face", "pencil"] = Field(
        "face", description="Light over the whole face, or on its middle (assumed: the thesis says collinear only)."
    )
    acceptance_deg: float = Field(
        30.0, gt=0.0, le=90.0, description="Half-angle of the sensor's cone (assumed: a fibre of aperture 0.5)."
    )
    specular: Literal["excluded", "included"] = Field(
        "excluded",
        description="Mirror reflection of the surface, which a flat sample sends straight back (assumed excluded).",
    )


class IntegratingSphere(_Part):
    """Total diffuse reflectance through the port of an integrating sphere, light from near the normal.

    Reads the flux that leaves within the port over the incident flux; what surfaces outside the port is missed.
    By reciprocity also what a sphere with diffuse light and a sensor at that angle reads. The sphere's own
    multiple reflections are taken as calibrated away.
    """

    kind: Literal["integrating-sphere"] = "integrating-sphere"
    sample_side_mm: Extent = Field("infinite", description="Side of the square sample in mm, or 'infinite'.")
    port_diameter_mm: Extent = Field(20.0, description="Diameter of the sample port in mm, or 'infinite' (assumed).")
    beam_diameter_mm: float = Field(5.0, ge=0.0, le=1e4, description="Diameter of the beam; 0: a pencil (assumed).")
    incidence_deg: float = Field(8.0, ge=0.0, lt=90.0, description="Angle of incidence (8/d geometry).")
    specular: Literal["excluded", "included"] = Field("included", description="Gloss trap open or closed.")

    @model_validator(mode="after")
    def _fits(self) -> IntegratingSphere:
        room = min(_size(self.port_diameter_mm), _size(self.sample_side_mm))
        if self.beam_diameter_mm > room:
            raise InputError.of(
                "beam_diameter_mm",
                self.beam_diameter_mm,
                f"must not exceed the port or sample ({room:g} mm)",
                "Narrow it.",
            )
        if self.port_diameter_mm != "infinite" and _size(self.sample_side_mm) < self.port_diameter_mm:
            raise InputError.of(
                "port_diameter_mm", self.port_diameter_mm, "must not exceed the sample's side", "Use a smaller port."
            )
        return self


class FibreProbe(_Part):
    """A source fibre and a detector fibre at a distance, both upright on an endless surface.

    Reads the share of the launched light that enters the detector fibre within its aperture. The light is
    launched upright (assumed), and the surface between the fibres meets the stack's medium above.
    """

    kind: Literal["fibre-probe"] = "fibre-probe"
    distance_mm: float = Field(1.0, gt=0.0, le=1e3, description="Between the fibres' axes.")
    source_radius_mm: float = Field(0.1, ge=0.0, le=1e2, description="Radius of the source fibre's core (assumed).")
    fibre_radius_mm: float = Field(0.1, gt=0.0, le=1e2, description="Radius of the detector fibre's core (assumed).")
    numerical_aperture: float = Field(0.22, gt=0.0, le=2.0, description="Of the detector fibre (assumed).")

    @model_validator(mode="after")
    def _apart(self) -> FibreProbe:
        if self.distance_mm < self.source_radius_mm + self.fibre_radius_mm:
            raise InputError.of(
                "distance_mm",
                self.distance_mm,
                f"must be at least the radii together ({self.source_radius_mm + self.fibre_radius_mm:g} mm)",
                "Two fibres cannot overlap.",
            )
        return self


class HyperspectralCamera(_Part):
    """A camera along the normal over a surface in broad, directed light.

    Reads the radiance factor in a cone about the normal, as `Collinear`, of an endless sample in even light.
    Crossed polarisers take out the surface's mirror reflection. They would also take out most of what was
    scattered once, which keeps its polarisation; the scalar walk cannot tell, and keeps it: an upper estimate.
    """

    kind: Literal["hyperspectral-camera"] = "hyperspectral-camera"
    illumination_deg: float = Field(45.0, ge=0.0, lt=90.0, description="Angle of incidence: 45, or near 0 (assumed).")
    polarisation: Literal["none", "crossed"] = Field("none", description="Crossed polarisers, or none (assumed).")
    acceptance_deg: float = Field(
        20.0, gt=0.0, le=90.0, description="Half-angle of the cone seen (assumed; wider than a lens's, for less noise)."
    )


Instrument = Annotated[Collinear | IntegratingSphere | FibreProbe | HyperspectralCamera, Field(discriminator="kind")]
"""A virtual instrument, by `kind`."""


class _Sampled(_Part):
    """A solver by chance: exactly one of three rules says when it has sampled enough."""

    kind: str
    estimator: Literal["expected", "analog"] = "expected"
    samples: int | None = None
    standard_error: float | None = Field(None, gt=0.0, description="Standard error that every wavelength must meet.")
    relative: float | None = Field(None, gt=0.0, lt=1.0, description="The same, as a share of the curve's maximum.")
    max_samples: int
    max_seconds: float | None = Field(None, gt=0.0, description="Seconds after which it stops, unfinished.")
    seed: int = Field(1, ge=0, lt=2**31, description="Seed of every draw.")

    default_relative: ClassVar[float]
    """The rule if none is given."""

    @model_validator(mode="before")
    @classmethod
    def _one_target(cls, given: Any) -> Any:
        return _one_rule(given, cls.default_relative)


class WalkSolver(_Sampled):
    """Monte Carlo (`livlab.model.transport.walk`), each wavelength with as many samples as it needs.

    Exactly one of `samples`, `standard_error` and `relative` rules; `relative` 0.002 if none is given.
    """

    kind: Literal["walk"] = "walk"
    estimator: Literal["expected", "analog"] = Field("expected", description="Summed rates and weights, or literal.")
    samples: int | None = Field(None, ge=1000, le=10**10, description="Samples for every wavelength.")
    pilot: int = Field(65536, ge=1000, le=10**8, description="Samples that first gauge each wavelength's noise.")
    largest_launch: int = Field(4_000_000, ge=1000, le=10**9, description="Samples in one launch, all wavelengths.")
    max_samples: int = Field(10**9, ge=1000, le=10**11, description="Samples after which a wavelength is given up.")

    default_relative: ClassVar[float] = 0.002


class TracerSolver(_Sampled):
    """The reference tracer: the sample as a block in a scene (`livlab.model.tracer.block`).

    A path serves all wavelengths. Exactly one of `samples`, `standard_error` and `relative` rules; `relative` 0.01 if
    none is given. It counts what the instrument reads, no budget of the rest.
    """

    kind: Literal["tracer"] = "tracer"
    estimator: Literal["expected", "analog"] = Field("expected", description="Survival by weight, or by chance.")
    samples: int | None = Field(None, ge=2048, le=10**10, description="Paths; each serves every wavelength.")
    launch: int = Field(131_072, ge=2048, le=10**8, description="Paths in one launch.")
    max_samples: int = Field(10**8, ge=2048, le=10**11, description="Paths after which it is given up.")

    default_relative: ClassVar[float] = 0.01


class AddingDoublingSolver(_Part):
    """Adding–doubling: no noise, but laterally endless layers only (`livlab.model.transport.adding_doubling`)."""

    kind: Literal["adding-doubling"] = "adding-doubling"
    tolerance: float = Field(1e-6, gt=0.0, le=1e-2, description="Absolute error of the totals.")


class AutoSolver(_Part):
    """The cheapest solver that can meet the experiment's `[accuracy]` (`livlab.model.transport.ladder`)."""

    kind: Literal["auto"] = "auto"
    pilot: int = Field(65536, ge=1000, le=10**8, description="Samples that first gauge each wavelength's noise.")
    largest_launch: int = Field(4_000_000, ge=1000, le=10**9, description="Samples in one launch, all wavelengths.")
    max_samples: int = Field(10**9, ge=1000, le=10**11, description="Samples after which a wavelength is given up.")
    max_seconds: float | None = Field(None, gt=0.0, description="Seconds after which a walk stops, unfinished.")
    seed: int = Field(1, ge=0, lt=2**31, description="Seed of every draw.")


DEFAULT_ACCURACY = Accuracy(relative=WalkSolver.default_relative)
"""What an `AutoSolver` is to meet if an experiment has no wish: what `WalkSolver` aims at, too."""

Solver = Annotated[WalkSolver | AddingDoublingSolver | TracerSolver | AutoSolver, Field(discriminator="kind")]
"""How the light is followed, by `kind`."""


def _one_rule(given: Any, default: float) -> Any:
    """What a solver was given, with the default rule if it was given none."""
    if not isinstance(given, dict):
        return given
    rules = [key for key in ("samples", "standard_error", "relative") if given.get(key) is not None]
    if len(rules) > 1:
        raise InputError.of("solver", " and ".join(rules), "only one of them can rule", "Drop the others.")
    return given if rules else {**given, "relative": default}


def _size(extent: float | str) -> float:
    return math.inf if isinstance(extent, str) else extent
