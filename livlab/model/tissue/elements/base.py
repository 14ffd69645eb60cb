"""What an element of a layer must be able to say of itself, and the plain records that it answers with.

An element is one class in one file: what a tissue file gives (its fields, with unit, bounds and meaning), and what is
made of it. Who asks (the optical stack, tables, the bench, the catalogue of effects) knows these records and no class.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import Field

from livlab.model.tissue.elements.parameters import ElementParameter, parameters_of
from livlab.model.tissue.readings import Reading, Subject
from livlab.model.tissue.setting import Setting, absorber
from livlab.model.tissue.spectra import Spec
from livlab.model.tissue.stack import Interaction
from livlab.units import FloatArray

Share = Annotated[float, Field(ge=0.0, le=1.0)]
Anisotropy = Annotated[float, Field(gt=-1.0, lt=1.0)]
Length = Annotated[float, Field(gt=0.0)]
Amount = Annotated[float, Field(ge=0.0)]

Budget = Literal["composition", "structure", ""]
"""Fractions are summed within a budget: what the volume consists of (blood, water, pigments) and what stands in it
(fibres, cells). A cell contains water, so the two overlap and are not summed together."""

HIDDEN = frozenset({"kind", "sources", "replaces"})
"""Fields that are no number of a tissue's table."""


@dataclass(frozen=True)
class Value:
    """A value of an element as tables show it; `key` is its path below the element, `phrase` its name in a sentence."""

    key: str
    label: str
    value: Any
    unit: str = ""
    phrase: str = ""


@dataclass(frozen=True)
class Derived:
    """A number that follows from an element under a reading, for the tissue's table."""

    label: str
    value: float
    unit: str
    source: str


@dataclass(frozen=True)
class Remarks:
    """What is to be told of an element under a reading.

    Attributes
    ----------
    coefficients, walk
        Sentences on what the reading makes of its coefficients, and of the walk at it.
    alone
        What it is ("fibres") if it scatters as if alone, so that many of them in a layer are worth a warning.
    derived
        Numbers that follow.
    """

    coefficients: tuple[str, ...] = ()
    walk: tuple[str, ...] = ()
    alone: str = ""
    derived: tuple[Derived, ...] = ()


@dataclass(frozen=True)
class Omission:
    """An effect within an element that a scene may do without, and the values (by key) that leave it out.

    Attributes
    ----------
    name, what, cost
        As `livlab.effects.catalogue.Effect`; elements that give one name are left out together.
    values
        Values by key below the element.
    absorbs_only
        Whether leaving it out only takes absorption away (−1) or only adds some (+1); 0 if it does more.
    """

    name: str
    what: str
    cost: str
    values: Mapping[str, Any]
    absorbs_only: int = 0


@dataclass(frozen=True)
class Slider:
    """A value that a bench can move: its path below the element, and the range to offer."""

    key: str
    label: str
    low: float
    high: float
    value: float
    unit: str = ""
    log: bool = False


@dataclass(frozen=True)
class MovableAbsorption:
    """An absorber as a page works it out again without Python.

    Attributes
    ----------
    formula
        "pigment": the slider `key` ("fraction" if not said) times `spectrum`. "blood": fraction, oxygenation between
        `deoxy` and `oxy`, packaging by vessel_radius_um. "mixture": fraction times the `spectra` of `names` weighed by
        the sliders parts.NAME.share, what `rest` names taking what is left.
    data
        What the formula reads; spectra in 1/mm.
    sliders
        Its sliders.
    now
        (W,) what it absorbs as it is, in 1/mm.
    """

    formula: Literal["pigment", "blood", "mixture"]
    data: Mapping[str, Any]
    sliders: tuple[Slider, ...]
    now: FloatArray


@dataclass(frozen=True)
class MovableScattering:
    """A scatterer as a page writes it down again with other strength and slope.

    Attributes
    ----------
    tilts
        Whether a change of its exponent makes sense; a layer's exponent can be moved if something in it tilts and all
        of these do.
    formula
        "power": another power law in its place, from `a_per_cm` at 500 nm, `b` and `anisotropy`. "cell": the value at
        `key` by a factor. "": it cannot be written so.
    key
        Value below the element that is written; the whole element if empty.
    data
        What the formula reads.
    """

    tilts: bool
    formula: Literal["power", "cell", ""] = ""
    key: str = ""
    data: Mapping[str, float] | None = None


@dataclass(frozen=True)
class ReferenceValue:
    """What an element must give, from a closed form or a publication and not from livlab.

    Attributes
    ----------
    source
        Where the numbers are from.
    element
        The element as a file gives it, without its kind.
    rate, albedo, anisotropy
        Expected rate in 1/mm, single-scattering albedo, and g of what scatters.
    wavelength_nm, n_medium
        Where.
    reading
        Name of the reading and the options changed in it.
    relative
        Tolerance of rate and anisotropy.
    """

    source: str
    element: Mapping[str, Any]
    rate: float
    albedo: float
    anisotropy: float | None = None
    wavelength_nm: float = 500.0
    n_medium: float = 1.0
    reading: tuple[str, Mapping[str, Any]] = ("consistent", {})
    relative: float = 1e-9


class ElementBase(Spec):
    """An element: its fields are what a file says, its methods what is made of them.

    A class with a `kind` that leaves out a method, the unit of a number, or the share that its budget counts, is
    refused when it is made.
    """

    sources: dict[str, str] = Field({}, description="Where each number came from, by its key.")

    budget: ClassVar[Budget] = ""
    units: ClassVar[dict[str, str]] = {}

    if TYPE_CHECKING:
        kind: str

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        super().__pydantic_init_subclass__(**kwargs)
        if "kind" not in cls.model_fields:
            return
        for method in sorted(cls.__abstractmethods__):
            what = str(getattr(cls, method).__doc__).splitlines()[0]
            raise TypeError(f"element {cls.__name__} lacks {method}: {what}")
        if cls.budget and cls.share is ElementBase.share:
            raise TypeError(f"element {cls.__name__} lacks share: its budget {cls.budget!r} counts it")
        for parameter in cls.parameters():
            if parameter.is_number and not parameter.unit:
                raise TypeError(f"element {cls.__name__} lacks a unit of {parameter.key}: write one into units")

    @abstractmethod
    def interaction(self, name: str, setting: Setting) -> Interaction:
        """The element as the walk meets it: rate, albedo and phase functions at each wavelength."""

    @abstractmethod
    def dataset_names(self) -> tuple[str, ...]:
        """Datasets that the element needs."""

    @abstractmethod
    def subjects(self) -> tuple[Subject, ...]:
        """What of the table of contradictions bears on it."""

    @abstractmethod
    def remarks(self, reading: Reading) -> Remarks:
        """What is to be told of it under a reading."""

    @abstractmethod
    def omissions(self) -> tuple[Omission, ...]:
        """Effects within it that a scene may do without; its scattering and absorption whole are none of them."""

    @abstractmethod
    def movable_absorption(self, name: str, setting: Setting) -> MovableAbsorption | None:
        """Its absorption as a bench moves it; None for what does not absorb or cannot be moved."""

    @abstractmethod
    def movable_scattering(self) -> MovableScattering | None:
        """Its scattering as a bench writes it down; None if that says nothing of the layer's."""

    @classmethod
    @abstractmethod
    def reference_values(cls) -> tuple[ReferenceValue, ...]:
        """Inputs and what must come out, from closed forms or publications."""

    def limits(self, name: str, key: str) -> str:
        """What a value does not do in this model, as a sentence; empty where there is nothing to say.

        Parameters
        ----------
        name
            What the layer calls the element.
        key
            Path of the value below the element.
        """
        return ""

    @property
    def share(self) -> float:
        """Volume fraction that counts in the layer's budget."""
        return 0.0

    @classmethod
    def share_key(cls) -> str:
        """Key of the volume fraction; empty for what has none."""
        return next((k for k in ("volume_fraction", "fraction") if cls.budget and k in cls.model_fields), "")

    def with_share(self, fraction: float) -> Self:
        """The same element at another volume fraction."""
        return self.model_copy(update={self.share_key(): fraction})

    @property
    def stands_in_for(self) -> str:
        """Element that it replaces where the reading takes published scattering; empty: it is always there."""
        return ""

    def settled(self) -> Self:
        """The element once the reading has chosen: it stands in for nobody any more."""
        return self.model_copy(update={"replaces": ""}) if self.stands_in_for else self

    def values(self) -> Iterator[Value]:
        """Every value that a table shows, in the order of the fields; what is not given is left out."""
        for key in type(self).model_fields:
            value = getattr(self, key)
            if key not in HIDDEN and value is not None:
                yield Value(key, key, value, self.units.get(key, ""))

    @classmethod
    def parameters(cls) -> tuple[ElementParameter, ...]:
        """A row a field: key, unit, bounds, default and meaning.

        Examples
        --------
        >>> from livlab.model.tissue.elements.blood import Blood
        >>> Blood.parameters()[1].key, Blood.parameters()[1].high
        ('oxygenation', 1.0)
        """
        return parameters_of(cls, cls.units, skip={"kind", "sources"})


class Absorber(ElementBase):
    """An element that only absorbs: it gives its `absorption`."""

    @abstractmethod
    def absorption(self, setting: Setting) -> FloatArray:
        """(W,) absorption in 1/mm."""

    def interaction(self, name: str, setting: Setting) -> Interaction:
        """An absorber ends every path that meets it."""
        return absorber(name, self.absorption(setting))

    def subjects(self) -> tuple[Subject, ...]:
        """None: the readings do not differ in what absorbs."""
        return ()

    def remarks(self, reading: Reading) -> Remarks:
        """Nothing, whatever the reading."""
        return Remarks()

    def movable_scattering(self) -> None:
        """None: it does not scatter."""

    def limits(self, name: str, key: str) -> str:
        """That it does not scatter, whatever its values."""
        return (
            f"In this model {name.replace('_', ' ')} only absorbs and does not scatter: more of it adds no particles."
        )


class Scatterer(ElementBase):
    """An element that is known by its scattering: it has no absorption to move and no inner effect to leave out."""

    def omissions(self) -> tuple[Omission, ...]:
        """None: its scattering is left out whole."""
        return ()

    def movable_absorption(self, name: str, setting: Setting) -> None:
        """None."""
