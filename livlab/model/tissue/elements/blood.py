"""Blood in vessels: absorption by oxygenation, and its packaging (Nunes 2019, eq. 6.12, 6.13)."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

from pydantic import Field

from livlab import datasets
from livlab.model.tissue import chromophores
from livlab.model.tissue.elements.base import (
    Absorber,
    Amount,
    Budget,
    MovableAbsorption,
    Omission,
    ReferenceValue,
    Share,
    Slider,
)
from livlab.model.tissue.setting import Setting
from livlab.units import FloatArray, um_to_mm

RADII_UM = (1.0, 100.0)
"""Range of vessels that a bench offers."""


class Blood(Absorber):
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

    def absorption(self, setting: Setting) -> FloatArray:
        """F σ C(R, σ), σ being whole blood's at this oxygenation."""
        return self._packed(self._whole(self.oxygenation, *self._extinctions(setting)))

    def omissions(self) -> tuple[Omission, ...]:
        """The packaging, where vessels have a width."""
        if not self.vessel_radius_um > 0:
            return ()
        return (
            Omission(
                name="packaging",
                what="blood packed in vessels, not spread evenly",
                cost="nothing in a walk: a factor on a coefficient",
                values={"vessel_radius_um": 0.0},
                absorbs_only=+1,
            ),
        )

    def movable_absorption(self, name: str, setting: Setting) -> MovableAbsorption:
        """Between deoxygenated and oxygenated blood, with the packaging."""
        extinctions = self._extinctions(setting)
        deoxy, oxy = (self._whole(s, *extinctions) for s in (0.0, 1.0))
        word, radius = name.replace("_", " "), self.vessel_radius_um
        return MovableAbsorption(
            formula="blood",
            data={"deoxy": deoxy, "oxy": oxy},
            sliders=(
                Slider("fraction", f"{word} fraction", 0.002, 0.2, self.fraction, log=True),
                Slider("oxygenation", "oxygenation", 0.0, 1.0, self.oxygenation),
                Slider("vessel_radius_um", "vessel radius", *RADII_UM, radius, unit="µm", log=True),
            ),
            now=self._packed(deoxy + self.oxygenation * (oxy - deoxy)),
        )

    def _extinctions(self, setting: Setting) -> tuple[FloatArray, FloatArray]:
        table = datasets.load(self.dataset)
        hbo2, hb = (
            table.interpolate(column, setting.wavelength_nm, unit="1/(cm M)")
            for column in (self.hbo2_column, self.hb_column)
        )
        return hbo2, hb

    def _whole(self, oxygenation: float, hbo2: FloatArray, hb: FloatArray) -> FloatArray:
        return chromophores.whole_blood(oxygenation, hbo2, hb, self.haemoglobin_g_per_l)

    def _packed(self, whole_per_mm: FloatArray) -> FloatArray:
        return chromophores.blood(self.fraction, whole_per_mm, um_to_mm(self.vessel_radius_um))

    @classmethod
    def reference_values(cls) -> tuple[ReferenceValue, ...]:
        """Prahl's table at 540 nm, with and without vessels."""
        per_mm = 0.1 * 2.303 * 150.0 / 64500.0 * (0.75 * 53236.0 + 0.25 * 46592.0)
        shadow = 2.0 * 0.05 * per_mm
        prahl = "Prahl 1999: 53236 and 46592 1/(cm M) at 540 nm, 2.303 ε · 150/64500"
        return (
            ReferenceValue(
                source=prahl,
                element={"fraction": 0.02, "oxygenation": 0.75, "vessel_radius_um": 0.0},
                wavelength_nm=540.0,
                rate=0.02 * per_mm,
                albedo=0.0,
            ),
            ReferenceValue(
                source=f"{prahl}; (1 − e^(−2Rσ))/(2Rσ) of eq. 6.13 at R = 50 µm",
                element={"fraction": 0.02, "oxygenation": 0.75, "vessel_radius_um": 50.0},
                wavelength_nm=540.0,
                rate=0.02 * per_mm * (1.0 - math.exp(-shadow)) / shadow,
                albedo=0.0,
            ),
        )
