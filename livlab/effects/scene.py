"""A scene: what is looked at and what looks at it; and its groups of layers."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from livlab.acquire.instruments.base import VirtualInstrument
from livlab.effects.reduce import Names
from livlab.model.tissue.stack import OpticalStack, PlaneLayer


@dataclass(frozen=True)
class OpticalScene:
    """An optical stack under an instrument."""

    stack: OpticalStack
    instrument: VirtualInstrument


@dataclass(frozen=True)
class LayerGroup:
    """A layer of the tissue: one plane layer, or sublayers "NAME 1", "NAME 2", ….

    Attributes
    ----------
    name
        The layer's name.
    members
        Names of its plane layers from the surface down.
    """

    name: str
    members: tuple[str, ...]

    @property
    def names(self) -> Names:
        """What its plane layers may be called, merged or not."""
        return frozenset((self.name, *self.members))


def groups(layers: Sequence[PlaneLayer]) -> tuple[LayerGroup, ...]:
    """Layers with their sublayers, numbered from 1, gathered.

    >>> import numpy as np
    >>> one = np.ones(1)
    >>> [g.name for g in groups([PlaneLayer(n, 1.0, one) for n in ("skin 1", "skin 2", "fat")])]
    ['skin', 'fat']
    """
    made: list[LayerGroup] = []
    before = ""
    for x in layers:
        found = re.fullmatch(r"(.+) (\d+)", x.name)
        stem, number = (found[1], int(found[2])) if found else (x.name, 0)
        if number > 1 and made and made[-1].name == stem and len(made[-1].members) == number - 1:
            made[-1] = LayerGroup(stem, (*made[-1].members, x.name))
        else:
            made.append(LayerGroup(stem if number == 1 and stem != before else x.name, (x.name,)))
        before = stem
    # A single "NAME 1" without a "NAME 2" is no sublayer.
    return tuple(LayerGroup(g.members[0], g.members) if len(g.members) == 1 else g for g in made)
