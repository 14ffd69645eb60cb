"""What a layer is made of: the kinds of element that a tissue file can name. Data only; `optics` gives them meaning."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from livlab.errors import InputError
from livlab.model.tissue.spectra import AbsorptionSpectrum, Extinction, Index, Spec, names_of

Share = Annotated[float, Field(ge=0.0, le=1.0)]
Anisotropy = Annotated[float, Field(gt=-1.0, lt=1.0)]
Length = Annotated[float, Field(gt=0.0)]
Amount = Annotated[float, Field(ge=0.0)]

Budget = Literal["composition", "structure", ""]
"""Fractions are summed within a budget: what the volume consists of (blood, water, pigments) and what stands in it
(fibres, cells). A cell contains water, so the two overlap and are not summed together."""


class _Element(Spec):
    sources: dict[str, str] = Field({}, description="Where each number came from, by its key.")

    budget: ClassVar[Budget] = ""
    units: ClassVar[dict[str, str]] = {}

    @property
    def share(self) -> float:
        """Volume fraction that counts in the layer's budget."""
        return 0.0

    def with_share(self, fraction: float) -> Any:
        """The same element at another volume fraction."""
        key = "volume_fraction" if "volume_fraction" in type(self).model_fields else "fraction"
        return self.model_copy(update={key: fraction})

    def dataset_names(self) -> tuple[str, ...]:
        """Datasets that the element needs."""
        return ()


class Fibre(_Element):
    """Fibres: collagen, elastin. Scatter only."""

    kind: Literal["fibre"]
    volume_fraction: Share = Field(description="Volume fraction.")
    diameter_um: Length = Field(description="Mean diameter in µm.")
    index: Index = Field(description="Refractive index, absolute.")
    law: Literal["mie", "rayleigh"] = Field("mie", description="Law that the thesis gives it.")

    budget: ClassVar[Budget] = "structure"
    units: ClassVar[dict[str, str]] = {"volume_fraction": "1", "diameter_um": "µm", "index": "1"}

    @property
    def share(self) -> float:
        """Volume fraction."""
        return self.volume_fraction

    def dataset_names(self) -> tuple[str, ...]:
        """The index's dataset, if any."""
        return names_of(self.index)


class Blood(_Element):
    """Blood in vessels. Absorbs only (Nunes 2019, eq. 6.12, 6.13)."""

    kind: Literal["blood"]
    fraction: Share = Field(description="Volume fraction of whole blood.")
    oxygenation: Share = Field(description="Oxygen saturation S_tO2, 0–1.")
    vessel_radius_um: Amount = Field(description="Mean vessel radius R in µm; 0 leaves the packaging out.")
    haemoglobin_g_per_l: Amount = Field(150.0, description="Haemoglobin of whole blood in g/L.")
    dataset: str = Field("haemoglobin_prahl", description="Dataset of the molar extinctions.")
    hbo2_column: str = Field("hbo2_molar_extinction_per_cm_per_M", description="Column of HbO2.")
    hb_column: str = Field("hb_molar_extinction_per_cm_per_M", description="Column of Hb.")

    budget: ClassVar[Budget] = "composition"
    units: ClassVar[dict[str, str]] = {
        "fraction": "1",
        "oxygenation": "1",
        "vessel_radius_um": "µm",
        "haemoglobin_g_per_l": "g/L",
    }

    @property
    def share(self) -> float:
        """Volume fraction."""
        return self.fraction

    def dataset_names(self) -> tuple[str, ...]:
        """The extinctions' dataset."""
        return (self.dataset,)


class Part(Spec):
    """A part of a mixture; the one part without a share takes the rest."""

    share: Share | None = Field(None, description="Share of the mixture, 0–1; the rest if not said.")
    spectrum: AbsorptionSpectrum = Field(description="Its absorption.")


class Mixture(_Element):
    """A mixture of absorbers, lipid and water for one (Nunes 2019, eq. 6.14)."""

    kind: Literal["mixture"]
    fraction: Share = Field(description="Volume fraction of the mixture.")
    parts: dict[str, Part] = Field(min_length=1, description="Its parts, by name.")

    budget: ClassVar[Budget] = "composition"
    units: ClassVar[dict[str, str]] = {"fraction": "1", "share": "1"}

    @model_validator(mode="after")
    def _shares_fit(self) -> Mixture:
        total = sum(p.share for p in self.parts.values() if p.share is not None)
        rest = [name for name, p in self.parts.items() if p.share is None]
        if total > 1.0 + 1e-9:
            raise InputError.of("parts", round(total, 9), "shares must sum to at most 1", "Lower a share.")
        if len(rest) > 1:
            raise InputError.of(
                "parts", tuple(rest), "only one part may leave its share out", "Give the others theirs."
            )
        return self

    @property
    def share(self) -> float:
        """Volume fraction."""
        return self.fraction

    def shares(self) -> dict[str, float]:
        """Share of each part, the rest worked out."""
        known = sum(p.share for p in self.parts.values() if p.share is not None)
        return {name: max(0.0, 1.0 - known) if p.share is None else p.share for name, p in self.parts.items()}

    def dataset_names(self) -> tuple[str, ...]:
        """The parts' datasets."""
        return tuple(name for part in self.parts.values() for name in part.spectrum.datasets)


class Pigment(_Element):
    """A pigment with a measured absorption, bile for one (Nunes 2019, eq. 6.15)."""

    kind: Literal["pigment"]
    fraction: Share = Field(description="Volume fraction.")
    spectrum: AbsorptionSpectrum = Field(description="Its absorption, pure.")

    budget: ClassVar[Budget] = "composition"
    units: ClassVar[dict[str, str]] = {"fraction": "1"}

    @property
    def share(self) -> float:
        """Volume fraction."""
        return self.fraction

    def dataset_names(self) -> tuple[str, ...]:
        """The spectrum's datasets."""
        return self.spectrum.datasets


class Solute(_Element):
    """A chromophore in solution, by its molar extinction: µa = ln(10) ε c (Beer and Lambert); bilirubin for one."""

    kind: Literal["solute"]
    concentration_umol_per_l: Amount = Field(description="Concentration c in the layer's own volume, in µmol/L.")
    spectrum: Extinction = Field(description="Its molar extinction ε, to the base 10.")

    units: ClassVar[dict[str, str]] = {"concentration_umol_per_l": "µmol/L"}

    def dataset_names(self) -> tuple[str, ...]:
        """The extinction's datasets."""
        return self.spectrum.datasets


class LawAbsorber(_Element):
    """An absorber with an analytic spectrum: f (s (λ/λ0)^−p + o), or f (s e^(−(λ−λ0)/d) + o); melanin for one."""

    kind: Literal["law_absorber"]
    fraction: Share = Field(description="Volume fraction f.")
    law: Literal["power", "exponential"] = Field(description="Form of the spectrum.")
    scale_per_cm: Amount = Field(description="Absorption s at the reference wavelength in 1/cm.")
    reference_nm: Length = Field(description="Reference wavelength λ0 in nm.")
    exponent: float | None = Field(None, description="Exponent p of the power law.")
    decay_nm: Length | None = Field(None, description="Decay d of the exponential in nm.")
    offset_per_cm: Amount = Field(0.0, description="Constant o in 1/cm.")

    budget: ClassVar[Budget] = "composition"
    units: ClassVar[dict[str, str]] = {
        "fraction": "1",
        "scale_per_cm": "1/cm",
        "reference_nm": "nm",
        "exponent": "1",
        "decay_nm": "nm",
        "offset_per_cm": "1/cm",
    }

    @model_validator(mode="after")
    def _own_parameter(self) -> LawAbsorber:
        needed, other = ("exponent", "decay_nm") if self.law == "power" else ("decay_nm", "exponent")
        if getattr(self, needed) is None or getattr(self, other) is not None:
            raise InputError.of("law", self.law, f"needs {needed}, and no {other}", f"Give {needed}.")
        return self

    @property
    def share(self) -> float:
        """Volume fraction."""
        return self.fraction


class Cell(_Element):
    """Spheroidal cells of two diameters, hepatocytes for one (Nunes 2019, eq. 6.16, 6.17)."""

    kind: Literal["cell"]
    fraction: Share = Field(description="Volume fraction.")
    a_um: Length = Field(description="Diameter across in µm: the two equal ones.")
    b_um: Length = Field(description="Diameter along in µm: the third one.")
    albedo: Share = Field(1.0, description="Single-scattering albedo.")
    anisotropy: Anisotropy = Field(description="g of its Henyey–Greenstein phase function.")

    budget: ClassVar[Budget] = "structure"
    units: ClassVar[dict[str, str]] = {"fraction": "1", "a_um": "µm", "b_um": "µm", "albedo": "1", "anisotropy": "1"}

    @property
    def share(self) -> float:
        """Volume fraction."""
        return self.fraction


class _ReducedScatterer(_Element):
    anisotropy: Anisotropy = Field(description="g of the Henyey–Greenstein phase function; µs = µs'/(1 − g).")
    replaces: str = Field(
        "",
        description="Element it stands in for where the reading takes published scattering; always there if not said.",
    )


class PowerLawScatterer(_ReducedScatterer):
    """Reduced scattering µs' = a (λ/λ0)^−b, or a (f_Ray (λ/λ0)⁻⁴ + (1−f_Ray)(λ/λ0)^−b_Mie) (Jacques 2013, eq. 1, 2)."""

    kind: Literal["power_law_scatterer"]
    a_per_cm: Amount = Field(description="µs' at the reference wavelength in 1/cm.")
    reference_nm: Length = Field(500.0, description="Reference wavelength λ0 in nm.")
    b: float | None = Field(None, description="Exponent of the first form.")
    f_ray: Share | None = Field(None, description="Rayleigh share of the second form.")
    b_mie: float | None = Field(None, description="Mie exponent of the second form.")

    units: ClassVar[dict[str, str]] = {
        "a_per_cm": "1/cm",
        "reference_nm": "nm",
        "b": "1",
        "f_ray": "1",
        "b_mie": "1",
        "anisotropy": "1",
    }

    @model_validator(mode="after")
    def _one_form(self) -> PowerLawScatterer:
        first, second = self.b is not None, self.f_ray is not None and self.b_mie is not None
        if first == second or (first and (self.f_ray is not None or self.b_mie is not None)):
            raise InputError.of(
                "b, f_ray, b_mie", (self.b, self.f_ray, self.b_mie), "needs b, or f_ray with b_mie", "Give one form."
            )
        return self


class PublishedScatterer(_ReducedScatterer):
    """Reduced scattering by a published fit: a row of a table in the form of `liver_reduced_scattering_jacques2013`."""

    kind: Literal["published_scatterer"]
    dataset: str = Field(description="Dataset of the fits.")
    reference: str = Field(description="Row, by its column `reference`.")
    form: Literal["power", "rayleigh_mie"] = Field("power", description="Which of the row's two forms.")

    units: ClassVar[dict[str, str]] = {"anisotropy": "1"}

    def dataset_names(self) -> tuple[str, ...]:
        """The fits' dataset."""
        return (self.dataset,)


Element = Annotated[
    Fibre | Blood | Mixture | Pigment | Solute | LawAbsorber | Cell | PowerLawScatterer | PublishedScatterer,
    Field(discriminator="kind"),
]
"""Any element, told apart by its `kind`."""
