"""Every effect of a scene as an object: what it is, what it costs, where it applies, and how to leave it out."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from livlab.effects import reduce
from livlab.effects.scene import LayerGroup, OpticalScene, groups
from livlab.model.tissue.elements.base import Omission
from livlab.model.tissue.readings import Reading
from livlab.model.tissue.stack import OpticalStack
from livlab.model.tissue.tissue import Tissue, override

CONES_DEG = (30, 60, 90)
"""Widths of the cone within which small angles of scattering may be taken together."""

Where = Literal["plane layers", "tracer only"]


@dataclass(frozen=True)
class Effect:
    """Something that light does in a scene, which may or may not matter there.

    Attributes
    ----------
    name
        As a configuration forces it.
    what
        What it is.
    cost
        What it costs a walk.
    where
        Whether plane layers know it, or only the tracer of shapes.
    stage
        Place in the order in which effects are left out: first what a layer is, last what surrounds it.
    drop
        The scene without it, a pure function; None for the tracer's own.
    absorbs_only
        Whether leaving it out only takes absorption away (−1) or only adds some (+1); 0 if it does more.
    """

    name: str
    what: str
    cost: str
    where: Where
    stage: int
    drop: Callable[[OpticalScene], OpticalScene] | None
    absorbs_only: int = 0


def catalogue(scene: OpticalScene, tissue: Tissue | None = None, reading: Reading | None = None) -> tuple[Effect, ...]:
    """The effects of a scene, in the order in which they are left out.

    Parameters
    ----------
    scene
        Stack and instrument.
    tissue, reading
        What the stack was made from, if that is known: effects that a stack cannot show (the packaging of blood in
        vessels) are listed only with them.

    Returns
    -------
    Effects with names of their own, the tracer's last.
    """
    stack, found = scene.stack, groups(scene.stack.layers)
    made: list[Effect] = []
    if tissue is not None and reading is not None:
        made += _omissions(stack, tissue, reading)
    for group in found:
        made += _scattering(stack, group)
    made += _elements(stack, found)
    for group in found:
        made += _layers(stack, group, alone=len(found) == 1)
    for group in found:
        made += _phases(stack, group)
    made += _indices(stack, found)
    made += _ends(scene)
    made += [
        Effect("surface-roughness", "facets tilted at random", "a microfacet at each surface", "tracer only", 99, None),
        Effect("wet-film", "a film of liquid on the surface", "two more interfaces", "tracer only", 99, None),
    ]
    return _named(sorted(made, key=lambda e: e.stage))


def _on_stack(change: Callable[[OpticalStack], OpticalStack]) -> Callable[[OpticalScene], OpticalScene]:
    return lambda scene: replace(scene, stack=change(scene.stack))


def _plane(
    name: str, what: str, cost: str, stage: int, change: Callable[[OpticalStack], OpticalStack], absorbs_only: int = 0
) -> Effect:
    return Effect(name, what, cost, "plane layers", stage, _on_stack(change), absorbs_only)


def _omissions(stack: OpticalStack, tissue: Tissue, reading: Reading) -> Iterator[Effect]:
    """What the tissue's own elements say can be left out of them, such as the packaging of blood in vessels."""
    from livlab.model.tissue.optics import optical_stack

    plain = tissue.under(reading)
    found: dict[str, tuple[Omission, dict[str, Any]]] = {}
    for k, layer in enumerate(plain.layers):
        for name, element in layer.elements.items():
            for omission in element.omissions():
                # By number: the choices of the reading are made, so a path stays as it is set.
                values = {f"layers.{k}.elements.{name}.{key}": v for key, v in omission.values.items()}
                found.setdefault(omission.name, (omission, {}))[1].update(values)
    before = {(x.name, i.name): i.rate for x in stack.layers for i in x.interactions}
    for omission, values in found.values():
        without = optical_stack(override(plain, values), reading, stack.wavelength_nm)
        after = {(x.name, i.name): i.rate for x in without.layers for i in x.interactions}
        rates = {key: rate for key, rate in after.items() if key in before and not np.array_equal(rate, before[key])}
        if rates:
            change = partial(reduce.with_rates, rates=rates)
            yield _plane(omission.name, omission.what, omission.cost, 0, change, omission.absorbs_only)


def _scattering(stack: OpticalStack, group: LayerGroup) -> Iterator[Effect]:
    parts = _scatterers(stack, group)
    if parts:
        change = partial(reduce.without_scattering, layers=group.names)
        what = f"scattering in the {group.name} ({', '.join(parts)})"
        yield _plane(f"{group.name}-scattering", what, "a collision at every free path", 1, change)


def _elements(stack: OpticalStack, found: tuple[LayerGroup, ...]) -> Iterator[Effect]:
    every = frozenset(x.name for x in stack.layers) | {g.name for g in found}
    for name in dict.fromkeys(i.name for x in stack.layers for i in x.interactions if i.rate.any()):
        holders = [g for g in found if name in _all(stack, g)]
        parts = [i for x in stack.layers for i in x.interactions if i.name == name]
        scatters = any((i.rate * i.albedo).any() for i in parts)
        absorbs = any((i.rate * (1.0 - i.albedo)).any() for i in parts)
        if scatters and not absorbs and len(holders) == 1 and _scatterers(stack, holders[0]) == [name]:
            continue  # the layer's scattering is the same effect
        kinds = [k for k, holds in (("scattering", scatters), ("absorption", absorbs)) if holds]
        what = f"{' and '.join(kinds)} by {name} in the {' and '.join(g.name for g in holders)}"
        change = partial(reduce.without_element, element=name, layers=every)
        cost = "collisions with it, and a draw of its own in the literal walk"
        yield _plane(name, what, cost, 2, change, 0 if scatters else -1)


def _layers(stack: OpticalStack, group: LayerGroup, *, alone: bool) -> Iterator[Effect]:
    cost = "its collisions, its interfaces, and its coefficients in every step"
    if not alone:
        change = partial(reduce.without_layers, names=group.names)
        yield _plane(group.name, f"the {group.name} whole", cost, 3, change)
    if len(group.members) > 1:
        for member in group.members:
            change = partial(reduce.without_layers, names=frozenset({member}))
            yield _plane(member, f"the sublayer {member}", cost, 3, change)
        parts = [x for x in stack.layers if x.name in group.members]
        if all(np.array_equal(x.n, parts[0].n) for x in parts) and not np.isinf(parts[-1].thickness_mm):
            merge = partial(reduce.merged, names=frozenset(group.members), name=group.name)
            what = f"the {group.name}'s {len(parts)} sublayers, told apart"
            yield _plane(f"{group.name}-sublayers", what, "interfaces crossed, coefficients in every step", 4, merge)


def _phases(stack: OpticalStack, group: LayerGroup) -> Iterator[Effect]:
    parts = [i for x in stack.layers if x.name in group.members for i in x.interactions if reduce.plain_scatterer(i)]
    phases = {id(p): p for i in parts for p in i.phases}
    g = max((p.anisotropy for p in phases.values()), default=0.0)
    if g <= 0.0:
        return
    cost = "many collisions that hardly turn the light"
    for cone in CONES_DEG:
        if any(reduce.widened_phase(p, cone)[1] < 1.0 for p in phases.values()):
            what = f"angles of scattering below {cone}° in the {group.name}, told apart"
            change = partial(reduce.widened, layers=group.names, angle_deg=float(cone))
            yield _plane(f"{group.name}-small-angles-{cone}", what, cost, 5, change)
    similar = partial(reduce.similar, layers=group.names)
    what = f"directions of scattering in the {group.name}, against µs(1−g) in all directions alike"
    yield _plane(f"{group.name}-anisotropy", what, cost, 6, similar)


def _indices(stack: OpticalStack, found: tuple[LayerGroup, ...]) -> Iterator[Effect]:
    every = (stack.n_above, *(x.n for x in stack.layers), stack.n_below)
    if any(np.ptp(n) > 0 for n in every):
        cost = "a walk of its own for every wavelength, where a ledger is kept"
        change = reduce.without_dispersion
        yield _plane("index-dispersion", "indices that change with wavelength", cost, 7, change)
    home = {member: g for g in found for member in g.members}
    for upper, lower in zip(stack.layers, stack.layers[1:], strict=False):
        if np.array_equal(upper.n, lower.n):
            continue
        a, b = home[upper.name], home[lower.name]
        inside = a is b
        names = (upper.name, lower.name) if inside else (a.name, b.name)
        change = partial(
            reduce.matched_interface,
            upper=frozenset({upper.name}) if inside else a.names,
            lower=frozenset({lower.name}) if inside else b.names,
        )
        what = f"the step of index between {names[0]} and {names[1]}"
        yield _plane(f"interface-{names[0]}-{names[1]}", what, "Fresnel at every crossing", 8, change)
    if not np.array_equal(stack.n_above, stack.layers[0].n):
        what = "Fresnel reflection and refraction at the surface, from without and within"
        cost = "Fresnel at the surface, and collisions of what it sends back"
        yield _plane("surface-fresnel", what, cost, 9, reduce.matched_surface)


def _ends(scene: OpticalScene) -> Iterator[Effect]:
    if not np.isinf(scene.stack.layers[-1].thickness_mm):
        what = "an end below: light that leaves there, or is sent back"
        yield _plane("transmission", what, "nothing: it ends photons", 10, reduce.endless)
    if scene.instrument.edges():
        yield Effect(
            "lateral-loss",
            "an end sideways: light that leaves through the sides or misses the port",
            "places and directions in space, followed at every step",
            "plane layers",
            11,
            lambda s: replace(s, instrument=s.instrument.endless()),
        )


def _all(stack: OpticalStack, group: LayerGroup) -> list[str]:
    return [i.name for x in stack.layers if x.name in group.members for i in x.interactions if i.rate.any()]


def _scatterers(stack: OpticalStack, group: LayerGroup) -> list[str]:
    parts = [i for x in stack.layers if x.name in group.members for i in x.interactions]
    return list(dict.fromkeys(i.name for i in parts if (i.rate * i.albedo).any()))


def _named(effects: list[Effect]) -> tuple[Effect, ...]:
    """Names that a configuration can hold as bare keys, each once."""
    made, known = [], {"mode", "tolerance", "tolerance_of"}
    for e in effects:
        name = base = re.sub(r"[^A-Za-z0-9]+", "-", e.name).strip("-").lower() or "effect"
        number = 2
        while name in known:
            name, number = f"{base}-{number}", number + 1
        known.add(name)
        made.append(replace(e, name=name))
    return tuple(made)
