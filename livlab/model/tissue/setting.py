"""What an element needs to know beside itself to become an interaction, and the two forms it takes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from livlab.model.tissue.phase.base import Phase
from livlab.model.tissue.phase.functions import Isotropic
from livlab.model.tissue.readings import Reading
from livlab.model.tissue.stack import Interaction
from livlab.units import FloatArray


@dataclass
class Setting:
    """Wavelengths, the index of the medium around the element, the reading, and the notes that reports must show."""

    wavelength_nm: FloatArray
    n_medium: FloatArray
    reading: Reading
    notes: dict[str, None] = field(default_factory=dict)

    def note(self, text: str) -> None:
        """Keep a warning, once."""
        self.notes[text] = None


def absorber(name: str, rate: FloatArray) -> Interaction:
    """An element that ends every path that meets it."""
    return Interaction(name, rate, np.zeros_like(rate), (Isotropic(),) * len(rate))


def scatterer(
    name: str, rate: FloatArray, phases: Callable[[], tuple[Phase, ...]], setting: Setting, **more: Any
) -> Interaction:
    """A scatterer of albedo 1 unless `more` says otherwise; phases are only worked out where they count."""
    uniform = setting.reading.scattering_phase == "isotropic" or not rate.any()
    chosen = (Isotropic(),) * len(rate) if uniform else phases()
    return Interaction(
        name, rate, more.pop("albedo", np.ones_like(rate)), chosen, setting.reading.redirect_factor, **more
    )
