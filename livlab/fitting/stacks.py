"""Optical stacks of one tissue at many values: only the layers that a value changes are made anew."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from livlab.errors import ConfigError, LivlabError
from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.readings import Reading
from livlab.model.tissue.stack import OpticalStack
from livlab.model.tissue.tissue import Tissue, override
from livlab.units import FloatArray

KEPT = 64
"""Layers kept by their values: more than the points that a gradient by differences asks for."""


class StackMaker:
    """Optical stacks by values of parameters; the same as `optical_stack` of the overridden tissue, sooner.

    A reading's choices depend on the paths that a user set and not on their values, so they are made once; a layer
    depends on its own values alone, so the others are kept.

    Parameters
    ----------
    tissue, reading
        The tissue, and how it is read.
    wavelength_nm
        (W,) rising.
    names
        Paths of the parameters.
    by
        Who changes the tissue, for `Tissue.given`.
    """

    def __init__(
        self, tissue: Tissue, reading: Reading, wavelength_nm: FloatArray, names: Sequence[str], by: str = "fit"
    ) -> None:
        self.tissue, self.reading, self.wavelength_nm = tissue, reading, wavelength_nm
        self.names, self.by = tuple(names), by
        self._whole: OpticalStack | None = None
        self._alone: dict[str, Tissue] = {}
        self._owned: dict[str, tuple[str, ...]] = {}
        self._kept: dict[tuple[str, tuple[float, ...]], OpticalStack] = {}

    def slow(self, values: Mapping[str, float]) -> OpticalStack:
        """The stack made from nothing.

        Raises
        ------
        ConfigError, InputError, RangeError
            As `override` and `optical_stack`.
        """
        changes = {name: float(values[name]) for name in self.names}
        return optical_stack(override(self.tissue, changes, by=self.by), self.reading, self.wavelength_nm)

    def __call__(self, values: Mapping[str, float]) -> OpticalStack:
        """The stack at given values.

        Raises
        ------
        ConfigError, InputError, RangeError
            Values at which the tissue does not hold together.
        """
        if self._whole is None:
            self._whole = self.slow(values)
            self._prepare(values)
        if not self._alone:
            return self.slow(values)
        try:
            parts = [self._layer(layer, values) for layer in self._alone]
        except LivlabError:
            return self.slow(values)  # it says where in the whole tissue
        notes = dict.fromkeys(note for part in parts for note in part.notes)
        return replace(self._whole, layers=tuple(layer for part in parts for layer in part.layers), notes=tuple(notes))

    def _prepare(self, values: Mapping[str, float]) -> None:
        """Make the reading's choices, and tell which layer each path belongs to; if one belongs to none, give up."""
        changes = {name: float(values[name]) for name in self.names}
        plain = override(self.tissue, changes, by=self.by).under(self.reading)
        owned: dict[str, list[str]] = {layer.name: [] for layer in plain.layers}
        for name in self.names:
            words = name.split(".")
            if len(words) < 3 or words[0] != "layers" or words[1] not in owned:
                return
            try:
                override(plain, {name: changes[name]})
            except ConfigError:
                continue  # of an element that this reading does without
            owned[words[1]].append(name)
        self._owned = {layer: tuple(names) for layer, names in owned.items()}
        self._alone = {layer.name: plain.model_copy(update={"layers": (layer,)}) for layer in plain.layers}

    def _layer(self, layer: str, values: Mapping[str, float]) -> OpticalStack:
        at = tuple(float(values[name]) for name in self._owned[layer])
        found = self._kept.get((layer, at))
        if found is None:
            changes = dict(zip(self._owned[layer], at, strict=True))
            alone = override(self._alone[layer], changes, by=self.by) if changes else self._alone[layer]
            found = optical_stack(alone, self.reading, self.wavelength_nm)
            while len(self._kept) >= KEPT:
                self._kept.pop(next(k for k in self._kept if self._owned[k[0]]))
            self._kept[layer, at] = found
        return found
