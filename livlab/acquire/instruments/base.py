"""What every virtual instrument answers for itself, and the small records that it answers with.

An instrument is one file: a class that derives from `VirtualInstrument` and defines what is abstract there, and a row
in the table of `livlab.acquire.instruments.models`. A class that leaves something out is refused when it is made.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.geometry import Readout
from livlab.model.transport.source import Source
from livlab.model.transport.tally import Tally
from livlab.units import FloatArray

Extent = Annotated[float, Field(gt=0.0, le=1e4)] | Literal["infinite"]
"""A length in mm, or a sample that never ends sideways."""

Movable = Literal["absorption", "scattering"]

_UNITS = {"_mm": "mm", "_deg": "°"}


@dataclass(frozen=True)
class Edge:
    """The edge of a sample or a port.

    Attributes
    ----------
    distance_mm
        From the beam's rim, or half the side of a square lit all over.
    sides
        Number of planes that every path beyond the edge has passed one of.
    plane_mm
        Their distance from the beam's rim.
    lit_all_over
        Whether the beam covers the whole square.
    """

    distance_mm: float
    sides: int
    plane_mm: float
    lit_all_over: bool = False


@dataclass(frozen=True)
class InstrumentParameter:
    """One setting of an instrument, as its field declares it.

    Attributes
    ----------
    name, unit
        As an experiment file writes it; the unit is empty for a number without one.
    default
        Its value if not said.
    bounds
        Least and largest number, ±inf where there is none; None for a choice of words.
    open_below, open_above
        Whether the bound itself is excluded.
    words
        Words that it may be, beside a number or in place of one.
    meaning
        What it is.
    """

    name: str
    unit: str
    default: float | str
    bounds: tuple[float, float] | None
    open_below: bool
    open_above: bool
    words: tuple[str, ...]
    meaning: str

    @classmethod
    def of(cls, name: str, schema: dict[str, Any]) -> InstrumentParameter:
        """From the field's JSON schema."""
        forms = schema.get("anyOf", [schema])
        number = next((f for f in forms if f.get("type") == "number"), None)
        words = tuple(word for f in forms for word in f.get("enum", [f["const"]] if "const" in f else []))
        bounds = None
        if number is not None:
            low = number.get("minimum", number.get("exclusiveMinimum", -math.inf))
            high = number.get("maximum", number.get("exclusiveMaximum", math.inf))
            bounds = (float(low), float(high))
        return cls(
            name=name,
            unit=next((unit for end, unit in _UNITS.items() if name.endswith(end)), ""),
            default=schema["default"],
            bounds=bounds,
            open_below=number is not None and "exclusiveMinimum" in number,
            open_above=number is not None and "exclusiveMaximum" in number,
            words=words,
            meaning=schema["description"],
        )


@dataclass(frozen=True)
class ReferenceCase:
    """A reading that is known: the settings, what is looked at, and the number.

    Attributes
    ----------
    source
        Where the number is from.
    instrument
        The instrument with its settings.
    expected, tolerance
        The reading, and how far from it is still right.
    stack
        What it looks at; None where the light that leaves is given.
    light
        (θ, r) flux that leaves in the bins of a tally, over the incident flux, in place of a stack.
    samples
        Photons of a walk; 0: by adding–doubling.
    """

    source: str
    instrument: VirtualInstrument
    expected: float
    tolerance: float
    stack: OpticalStack | None = None
    light: Callable[[Tally], FloatArray] | None = None
    samples: int = 0


class StrictSettings(BaseModel):
    """A part of an experiment file: frozen, of exact types, and without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class VirtualInstrument(StrictSettings):
    """A virtual instrument: its settings, and all that depends on which instrument it is.

    Raises
    ------
    TypeError
        On deriving a class that leaves an abstract method out, or a field without a description.
    """

    kind: str

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        super().__pydantic_init_subclass__(**kwargs)
        missing = sorted(cls.__abstractmethods__)
        if missing:
            raise TypeError(f"instrument {cls.__name__} does not define {', '.join(missing)}")
        mute = [name for name, field in cls.model_fields.items() if name != "kind" and not field.description]
        if mute:
            raise TypeError(f"instrument {cls.__name__} does not describe {', '.join(mute)}")

    @abstractmethod
    def readout(self, n_above: FloatArray) -> Readout:
        """The instrument in a solver's terms, under a medium of the indices `n_above` (one a wavelength)."""

    @abstractmethod
    def edges(self) -> tuple[Edge, ...]:
        """The edge that its light may pass and be lost, described in each way that helps; none if nothing ends."""

    @abstractmethod
    def endless(self) -> Self:
        """The instrument over a sample, and with a port, that never end: it has no `edges`."""

    @property
    @abstractmethod
    def lateral_distance(self) -> str:
        """What distance along the surface its reading depends on, so that no solver without places serves; or ''."""

    @abstractmethod
    def endless_notes(self) -> list[str]:
        """What is said of a reading by adding–doubling, which knows neither sides nor ports."""

    @classmethod
    @abstractmethod
    def cases(cls) -> tuple[ReferenceCase, ...]:
        """Readings known in closed form or published, which the tests hold against the code."""

    @property
    def words(self) -> str:
        """Its kind in words."""
        return self.kind.replace("-", " ")

    @property
    def scale_free(self) -> bool:
        """Whether nothing of it has a size: over an endless layer only ratios of coefficients then count."""
        return not self.edges() and not self.lateral_distance

    @property
    def sliders(self) -> tuple[Movable, ...]:
        """What of an endless last layer a bench can move with one recorded walk."""
        return ("absorption", "scattering") if self.scale_free else ("absorption",)

    @classmethod
    def parameters(cls) -> tuple[InstrumentParameter, ...]:
        """Its settings with unit, bounds and meaning, as the fields declare them."""
        fields = cls.model_json_schema()["properties"]
        return tuple(InstrumentParameter.of(name, field) for name, field in fields.items() if name != "kind")


def length_mm(extent: float | str) -> float:
    """An extent in mm; inf if endless."""
    return math.inf if isinstance(extent, str) else extent


def half_mm(extent: float | str) -> float | None:
    """Half of an extent in mm; None if endless."""
    return None if isinstance(extent, str) else extent / 2


def sample_note(side_mm: float | str) -> list[str]:
    """What is said where a sample of some side is taken as endless."""
    if isinstance(side_mm, str):
        return []
    return [f"adding-doubling takes the sample of {side_mm:g} mm as endless: nothing is lost sideways"]


def cone_readout(source: Source, acceptance_deg: float, half_width_mm: float | None, *, specular: bool) -> Readout:
    """Radiance factor: π L / E = flux within the cone over sin²α (a Lambertian sends that share there)."""
    acceptance = math.radians(acceptance_deg)
    weight = 1.0 / math.sin(acceptance) ** 2
    whole = acceptance_deg == 90.0
    mirror_seen = source.angle_rad <= acceptance
    return Readout(
        source,
        Tally() if whole else Tally(theta_edges=(0.0, acceptance)),
        half_width_mm,
        np.array([[weight]]),
        weight if specular and mirror_seen else 0.0,
        mirror_seen,
    )
