"""The optics experiment: figures of what tissue is made of, before any light is followed through it.

Two sorts: scatterers (Mie against Rayleigh: phase functions and spectra) and chromophores (absorption spectra).
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from livlab.config.errors import nearest
from livlab.config.schema import Experiment, Label, Section, Text
from livlab.criteria import Wanted
from livlab.errors import InputError
from livlab.kinds.shared.criterion import Judged
from livlab.kinds.shared.sections import Wavelength, Wavelengths

Refractive = Annotated[float, Field(gt=0.1, lt=10.0)]
Radius = Annotated[float, Field(gt=0, lt=100.0)]

SCATTERING = ("pearson", "rmse", "log ratio", "phase rmse", "anisotropy")
ABSORPTION = ("value", "peak", "crossing")
LARGEST_SIZE = 1e4


class Particle(Section):
    """A sphere of one material in another, at every radius of the experiment."""

    label: Label = Field(description="How criteria and the report call it, e.g. in air.")
    n_particle: Refractive = Field(description="Refractive index of the sphere.")
    n_medium: Refractive = Field(1.0, description="Refractive index around it.")


class Published(Section):
    """A number printed for a sphere elsewhere, to hold the Mie series against."""

    label: Label = Field(description="Where it is printed.")
    n_particle: Refractive = Field(description="Refractive index of the sphere.")
    n_medium: Refractive = Field(1.0, description="Refractive index around it.")
    radius_um: Radius = Field(description="Radius in µm.")
    wavelength_nm: Wavelength = Field(description="Wavelength in vacuum in nm.")
    quantity: Literal["q_ext", "q_sca", "q_back", "anisotropy"] = Field(description="What is printed.")
    value: float = Field(description="The printed value.")
    tolerance: Annotated[float, Field(ge=0)] = Field(description="Half a unit of its last printed digit, or more.")


class Chromophore(Section):
    """A spectrum of absorption from a dataset."""

    label: Label = Field(description="How criteria and the report call it, e.g. water.")
    dataset: str = Field(min_length=1, description="Dataset by name (`livlab data list`).")
    column: str = Field("absorption_per_cm", min_length=1, description="Column: absorption, or molar extinction.")
    haemoglobin_g_per_l: Annotated[float, Field(gt=0, lt=1e4)] | None = Field(
        None, description="For a molar extinction: haemoglobin in g/L; absorption is 2.303 ε x/64500 (Prahl)."
    )


class OpticsCriterion(Judged):
    """A claim to judge; one of `checks` unless it says otherwise."""

    metric: Literal["pearson", "rmse", "log ratio", "phase rmse", "anisotropy", "value", "peak", "crossing"] = Field(
        description="Of scattering efficiencies over the wavelengths (pearson, rmse: of the curves over their maxima; "
        "log ratio: mean of |log10(Rayleigh/Mie)|), of the phase function (phase rmse: of 4π p over the cosine; "
        "anisotropy: Mie's), or of absorption (value in 1/cm; peak and crossing: wavelengths in nm)."
    )
    of: Label = Field(description="Label of a particle or chromophore.")
    radius_um: Radius | None = Field(None, description="One of the experiment's radii; for scattering.")
    against: Label | None = Field(None, description="Label of the other chromophore; for a crossing.")
    wavelength_nm: Wavelength | None = Field(None, description="Where the absorption is read; for a value.")
    band_nm: tuple[Wavelength, Wavelength] | None = Field(
        None, strict=False, description="Where the peak or crossing is sought."
    )
    source: Text = Field("", description="Where the reference is from; shown in the report.")

    @property
    def aim(self) -> Wanted:
        """What it wants."""
        return self.aims(self.metric, "checks")

    @property
    def name(self) -> str:
        """The claim's name."""
        if self.metric in SCATTERING:
            against = "" if self.metric == "anisotropy" else " vs Rayleigh"
            return f"{self.metric} Mie{against}, r {self.radius_um:g} µm {self.of}"
        if self.metric == "value":
            return f"absorption of {self.of} at {self.wavelength_nm:g} nm in 1/cm"
        low, high = self.band_nm or (0.0, 0.0)
        what = f"{self.of} crosses {self.against}" if self.metric == "crossing" else f"peak of {self.of}"
        return f"{what} within {low:g}-{high:g} nm"

    @model_validator(mode="after")
    def _fits(self) -> Self:
        wanted = {
            "radius_um": self.metric in SCATTERING,
            "wavelength_nm": self.metric == "value",
            "band_nm": self.metric in ("peak", "crossing"),
            "against": self.metric == "crossing",
        }
        for key, needed in wanted.items():
            if (getattr(self, key) is not None) != needed:
                bound = f"metric {self.metric!r} {'needs it' if needed else 'does not use it'}"
                raise InputError.of(key, getattr(self, key), bound, "Give it." if needed else "Leave it out.")
        if self.band_nm is not None and not self.band_nm[0] < self.band_nm[1]:
            raise InputError.of("band_nm", self.band_nm, "must rise", "Give [first, last].")
        return self


class OpticsExperiment(Experiment):
    """Figures of scatterers, or of chromophores."""

    kind: Literal["optics"] = "optics"
    wavelengths: Wavelengths = Field(description="Where the spectra are drawn.")
    radii_um: tuple[Radius, ...] = Field((), strict=False, max_length=8, description="Radii of the particles in µm.")
    phase_wavelength_nm: Wavelength = Field(550.0, description="Wavelength of the phase functions in nm.")
    particle: tuple[Particle, ...] = Field((), strict=False, max_length=6, description="Scatterers to draw.")
    published: tuple[Published, ...] = Field((), strict=False, description="Printed values of spheres.")
    chromophore: tuple[Chromophore, ...] = Field((), strict=False, max_length=8, description="Absorbers to draw.")
    criterion: tuple[OpticsCriterion, ...] = Field((), strict=False, description="Claims to judge.")

    @model_validator(mode="after")
    def _holds_together(self) -> Self:
        if bool(self.particle) == bool(self.chromophore):
            given = {"particle": len(self.particle), "chromophore": len(self.chromophore)}
            raise InputError.of("optics", given, "needs either particles or chromophores", "Give one of the two.")
        if bool(self.radii_um) != bool(self.particle):
            raise InputError.of("radii_um", self.radii_um, "goes with [[particle]]", "Give both or neither.")
        if list(self.radii_um) != sorted(set(self.radii_um)):
            raise InputError.of("radii_um", self.radii_um, "must rise", "Sort the radii.")
        labels = [p.label for p in self.particle] + [c.label for c in self.chromophore]
        names = [x.name for x in self.criterion] + [f"{x.label}: {x.quantity}" for x in self.published]
        for what, values in (("label", labels), ("criterion", names)):
            twice = next((v for v in values if values.count(v) > 1), None)
            if twice is not None:
                raise InputError.of(what, twice, "appears twice", "Give each its own.")
        known = SCATTERING if self.particle else ABSORPTION
        for k, criterion in enumerate(self.criterion):
            self._check(f"criterion[{k}]", criterion, known, labels)
        shortest = float(self.wavelengths.grid()[0])
        for radius, n, wavelength in (
            *((self.radii_um[-1], max(p.n_medium, p.n_particle), shortest) for p in self.particle),
            *((p.radius_um, max(p.n_medium, p.n_particle), p.wavelength_nm) for p in self.published),
        ):
            if 2e3 * math.pi * radius * n / wavelength > LARGEST_SIZE:
                bound = f"makes a size parameter over {LARGEST_SIZE:g}"
                raise InputError.of("radius_um", radius, bound, "Take a smaller sphere.")
        return self

    def _check(self, where: str, criterion: OpticsCriterion, known: tuple[str, ...], labels: list[str]) -> None:
        if criterion.metric not in known:
            raise InputError.of(f"{where}.metric", criterion.metric, f"must be one of {', '.join(known)}", "Pick one.")
        for key, label in (("of", criterion.of), ("against", criterion.against)):
            if label is not None and label not in labels:
                hint = nearest(label, labels) or f"Known: {', '.join(labels)}."
                raise InputError.of(f"{where}.{key}", label, "names none that there is", hint)
        if criterion.radius_um is not None and criterion.radius_um not in self.radii_um:
            raise InputError.of(
                f"{where}.radius_um", criterion.radius_um, f"must be one of {self.radii_um}", "Mend it."
            )
        grid = self.wavelengths.grid()
        asked = (*(criterion.band_nm or ()), *([criterion.wavelength_nm] if criterion.wavelength_nm else []))
        for x in asked:
            if not grid[0] <= x <= grid[-1]:
                bound = f"must lie within {grid[0]:g}–{grid[-1]:g} nm"
                raise InputError.of(f"{where}: wavelength", x, bound, "Widen the wavelengths.")

    def datasets(self) -> tuple[str, ...]:
        """Datasets of the chromophores, sorted."""
        return tuple(sorted({c.dataset for c in self.chromophore}))
