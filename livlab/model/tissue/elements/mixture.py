"""A mixture of absorbers by shares, lipid and water for one (Nunes 2019, eq. 6.14)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, Literal

from pydantic import Field, model_validator

from livlab.errors import InputError
from livlab.model.tissue import chromophores
from livlab.model.tissue.elements.base import (
    Absorber,
    Budget,
    MovableAbsorption,
    Omission,
    ReferenceValue,
    Share,
    Slider,
    Value,
)
from livlab.model.tissue.setting import Setting
from livlab.model.tissue.spectra import AbsorptionSpectrum, Spec
from livlab.units import FloatArray


class Part(Spec):
    """A part of a mixture; the one part without a share takes the rest."""

    share: Share | None = Field(None, description="Share of the mixture, 0–1; the rest if not said.")
    spectrum: AbsorptionSpectrum = Field(description="Its absorption.")


class Mixture(Absorber):
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

    def absorption(self, setting: Setting) -> FloatArray:
        """F Σ s_i σ_i."""
        return self._mixed(list(self._spectra(setting).values()))

    def omissions(self) -> tuple[Omission, ...]:
        """None."""
        return ()

    def movable_absorption(self, name: str, setting: Setting) -> MovableAbsorption:
        """By the mixture's fraction and each share that is said."""
        spectra = self._spectra(setting)
        rest = [n for n, p in self.parts.items() if p.share is None]
        return MovableAbsorption(
            formula="mixture",
            data={"names": list(spectra), "rest": rest[0] if rest else "", "spectra": list(spectra.values())},
            sliders=(
                Slider("fraction", name.replace("_", " "), 0.3, 0.95, self.fraction),
                *(
                    Slider(f"parts.{n}.share", f"{n} share of it", 0.0, 0.6, p.share)
                    for n, p in self.parts.items()
                    if p.share is not None
                ),
            ),
            now=self._mixed(list(spectra.values())),
        )

    def values(self) -> Iterator[Value]:
        """The fraction, then share and spectrum of each part."""
        yield Value("fraction", "fraction", self.fraction, self.units["fraction"])
        for part, share in self.shares().items():
            yield Value(f"parts.{part}.share", f"{part} share", share, self.units["share"], f"share of {part}")
            yield Value(f"parts.{part}.spectrum", f"{part} spectrum", self.parts[part].spectrum)

    def limits(self, name: str, key: str) -> str:
        """That its parts only absorb: fat adds no droplets."""
        words = key.split(".")
        if len(words) == 3 and words[0] == "parts":
            return f"In this model {words[1]} only absorbs and does not scatter: a larger share of it adds no droplets."
        return super().limits(name, key)

    def _spectra(self, setting: Setting) -> dict[str, FloatArray]:
        return {n: p.spectrum.per_mm(setting.wavelength_nm, setting.note) for n, p in self.parts.items()}

    def _mixed(self, spectra: list[FloatArray]) -> FloatArray:
        return chromophores.mixture(self.fraction, list(self.shares().values()), spectra)

    @classmethod
    def reference_values(cls) -> tuple[ReferenceValue, ...]:
        """Pope & Fry's water beside a part without any."""
        spectrum = {"datasets": ["water_pope_fry1997"]}
        return (
            ReferenceValue(
                source="Pope & Fry 1997, Table 3: 0.624 1/m at 700 nm, twice a share of the same water",
                element={
                    "fraction": 0.5,
                    "parts": {"a": {"share": 0.25, "spectrum": spectrum}, "b": {"spectrum": spectrum}},
                },
                wavelength_nm=700.0,
                rate=0.5 * 0.624e-3,
                albedo=0.0,
            ),
        )
