"""A BRDF model on packed samples as an objective: parameters by channel, residuals, and their derivatives."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from livlab.brdf.fit.data import Packed
from livlab.brdf.fit.loss import Loss, make_loss
from livlab.brdf.models.model import Lobe, Model
from livlab.errors import InputError
from livlab.optimise import Parameter, ParameterSpace
from livlab.units import FloatArray

Sharing = Literal["shape", "all", "none"] | Collection[str]
"""Which parameters all channels have in common: those of shape, all, none, or the named ones."""

STEP = 1e-4
"""Step in a transformed shape parameter for its central difference: errors of 1e-8 of the derivative."""


@dataclass(frozen=True)
class Choices:
    """What a user may change about a model's parameters.

    Parameters
    ----------
    shared
        See `Sharing`.
    fixed
        Values to hold, one number or one a channel.
    free
        Names that are fixed by default and shall be fitted.
    bounds
        (low, high) by name.
    start
        Start values by name, one number or one a channel.
    """

    shared: Sharing = "shape"
    fixed: Mapping[str, ArrayLike] | None = None
    free: Collection[str] = ()
    bounds: Mapping[str, tuple[float, float]] | None = None
    start: Mapping[str, ArrayLike] | None = None


class Layout:
    """Which fit parameter serves which model parameter in which channel."""

    def __init__(self, model: Model, channels: tuple[str, ...], choices: Choices) -> None:
        self.model, self.channels = model, channels
        fixed, start = choices.fixed or {}, choices.start or {}
        bounds = choices.bounds or {}
        known = [p.name for p in model.parameters]
        named = set() if isinstance(choices.shared, str) else set(choices.shared)
        for field, names in (("fixed", fixed), ("free", choices.free), ("bounds", bounds), ("start", start)):
            _check_names(field, names, known, model.name)
        _check_names("shared", named, known, model.name)
        if isinstance(choices.shared, str) and choices.shared not in ("shape", "all", "none"):
            raise InputError.of("shared", choices.shared, "must be shape, all, none or names", "Use shape.")
        parameters: list[Parameter] = []
        self.names: dict[str, tuple[str, ...]] = {}
        for entry in model.parameters:
            p = entry.parameter
            if p.name in bounds:
                low, high = bounds[p.name]
                middle = None if p.start is None else min(max(p.start, low), high)
                p = replace(p, low=low, high=high, start=middle)
            p = replace(p, fixed=p.fixed and p.name not in choices.free)
            common = not entry.per_channel if choices.shared == "shape" else choices.shared == "all" or p.name in named
            vectors = [np.ndim(s[p.name]) > 0 for s in (fixed, start) if p.name in s]
            split = len(channels) > 1 and (not common or any(vectors))
            labels = tuple(f"{p.name}[{c}]" for c in channels) if split else (p.name,) * max(len(channels), 1)
            self.names[p.name] = labels
            for k, label in enumerate(dict.fromkeys(labels)):
                one = replace(p, name=label)
                if p.name in start:
                    one = replace(one, start=_number(f"start.{p.name}", start[p.name], k, len(channels)))
                if p.name in fixed:
                    value = _number(f"fixed.{p.name}", fixed[p.name], k, len(channels))
                    one = replace(one, start=value, fixed=True)
                parameters.append(one)
        self.parameters = tuple(parameters)
        self.space = ParameterSpace(self.parameters)
        scales = {lobe.scale for lobe in model.lobes if lobe.scale is not None}
        self.scale_names = {label for name in scales for label in self.names[name]}
        self.shape_names = tuple(n for n in self.space.names if n not in self.scale_names)
        self.base_name = {label: name for name, labels in self.names.items() for label in labels}

    def of_channel(self, values: Mapping[str, float], channel: int) -> dict[str, float]:
        """The model's parameters in one channel."""
        return {name: values[labels[channel]] for name, labels in self.names.items()}

    def quick(self, lobe: Lobe) -> Lobe:
        """The lobe with its kernel for searches, where it has one and all but its roughness stays as it is."""
        if lobe.quick is None:
            return lobe
        old = {lobe.renames.get(p.name, p.name): p.name for p in lobe.parameters}
        stays = [n for o, n in old.items() if o != "alpha" and n != lobe.scale]
        labels = [self.names[n] for n in stays]
        if any(len(set(ls)) > 1 or ls[0] in self.space.names for ls in labels):
            return lobe
        start = self.space.values(self.space.start)
        held = {o: start[self.names[n][0]] for o, n in old.items()}
        alpha = self.space.by_name[self.names[old["alpha"]][0]]
        if alpha.name not in self.space.names or not 0 < alpha.low < alpha.high <= 1:
            return lobe
        return replace(lobe, kernel=lobe.quick(held, alpha.low, alpha.high))


def _check_names(field: str, names: Collection[str], known: list[str], model: str) -> None:
    unknown = sorted(set(names) - set(known))
    if unknown:
        raise InputError.of(field, unknown, f"{model} has no such parameter", f"It has {known}.")


def _number(field: str, value: ArrayLike, k: int, channels: int) -> float:
    array = np.atleast_1d(np.asarray(value, dtype=np.float64))
    if array.size not in (1, channels):
        raise InputError.of(field, array.tolist(), f"must be 1 or {channels} numbers", "Give one a channel.")
    return float(array[k if array.size > 1 else 0])


class BrdfProblem:
    """Half the sum of squared residuals, with its gradient and its normal equations."""

    def __init__(
        self,
        layout: Layout,
        data: Packed,
        loss_name: str,
        weights: FloatArray | None = None,
        *,
        quick: bool = False,
    ) -> None:
        self.layout, self.data = layout, data
        self.lobes = tuple(layout.quick(lobe) if quick else lobe for lobe in layout.model.lobes)
        self.loss: Loss = make_loss(loss_name, data)
        if weights is not None:
            self.loss = replace(self.loss, root=self.loss.root * np.sqrt(weights))
        self._bases: dict[tuple[object, ...], FloatArray] = {}
        self._residuals: tuple[tuple[float, ...], list[FloatArray]] | None = None

    def basis(self, number: int, lobe: Lobe, values: Mapping[str, float], square: bool = False) -> FloatArray:
        """A lobe averaged over each sample's points for a scale of 1; the last few are remembered."""
        shape = tuple(values[p.name] for p in lobe.parameters if p.name != lobe.scale)
        key = (number, square, *shape)
        if key not in self._bases:
            if len(self._bases) > 3 * len(self.lobes) * max(len(self.layout.channels), 1) + 6:
                self._bases.clear()
            raw = lobe.second(self.data.at, values) if square else lobe.basis(self.data.at, values)
            self._bases[key] = self.data.averaged(raw if raw is not None else np.zeros(self.data.weight.size))
        return self._bases[key]

    def predicted(self, values: Mapping[str, float], channel: int) -> FloatArray:
        """The model's values (n,) of one channel, pixels integrated, 1/sr."""
        return self._sum(self.layout.of_channel(values, channel))

    def _sum(self, own: Mapping[str, float], only: str | None = None) -> FloatArray:
        total = np.zeros(self.data.size)
        for number, lobe in enumerate(self.lobes):
            if only is not None and all(p.name != only for p in lobe.parameters):
                continue
            scale = 1.0 if lobe.scale is None else own[lobe.scale]
            total += scale * self.basis(number, lobe, own)
            if lobe.square is not None:
                total += scale * scale * self.basis(number, lobe, own, square=True)
        return total

    def residuals(self, values: Mapping[str, float]) -> list[FloatArray]:
        """Residuals (n,) of each channel."""
        key = tuple(values.values())
        if self._residuals is None or self._residuals[0] != key:
            found = [self.loss.residual(self.predicted(values, c), c) for c in range(len(self.layout.channels))]
            self._residuals = (key, found)
        return self._residuals[1]

    def value(self, values: Mapping[str, float]) -> float:
        """Half the sum of squares."""
        # Not r @ r: BLAS wakes every core for it, which on a busy machine costs more than the sum.
        return 0.5 * sum(float(np.einsum("n,n->", r, r)) for r in self.residuals(values))

    def columns(self, values: Mapping[str, float], channel: int) -> tuple[list[str], FloatArray]:
        """Names of the free parameters of one channel, and the derivatives (k, n) of its residuals by them."""
        layout = self.layout
        own = layout.of_channel(values, channel)
        slope = self.loss.slope(self.predicted(values, channel), channel)
        free = set(layout.space.names)
        names, rows = [], []
        for name, labels in layout.names.items():
            label = labels[channel]
            if label not in free:
                continue
            names.append(label)
            if label in layout.scale_names:
                rows.append(slope * self._by_scale(own, name))
            else:
                rows.append(slope * self._by_shape(own, name, layout.space.by_name[label]))
        return names, np.array(rows).reshape(len(rows), self.data.size)

    def _by_scale(self, own: Mapping[str, float], name: str) -> FloatArray:
        total = np.zeros(self.data.size)
        for number, lobe in enumerate(self.lobes):
            if lobe.scale == name:
                total += self.basis(number, lobe, own)
                if lobe.square is not None:
                    total += 2.0 * own[name] * self.basis(number, lobe, own, square=True)
        return total

    def _by_shape(self, own: Mapping[str, float], name: str, p: Parameter) -> FloatArray:
        t = p.inward(own[name])
        step = STEP * (max(abs(t), 0.1) if p.transform == "linear" else 1.0)
        low, high = p.outward(t - step), p.outward(t + step)
        ends = [self._sum({**own, name: v}, only=name) for v in (low, high)]
        return (ends[1] - ends[0]) / (high - low)

    def gradient(self, values: Mapping[str, float]) -> dict[str, float]:
        """Derivative of `value` by each free parameter."""
        total = dict.fromkeys(self.layout.space.names, 0.0)
        for c, r in enumerate(self.residuals(values)):
            names, rows = self.columns(values, c)
            for name, part in zip(names, np.einsum("kn,n->k", rows, r), strict=True):
                total[name] += float(part)
        return total

    def lengths(self, values: Mapping[str, float]) -> FloatArray:
        """Length of each free parameter's column of the Jacobian, in its own unit."""
        total = dict.fromkeys(self.layout.space.names, 0.0)
        for c in range(len(self.layout.channels)):
            names, rows = self.columns(values, c)
            for name, part in zip(names, np.einsum("kn,kn->k", rows, rows), strict=True):
                total[name] += float(part)
        return np.sqrt(np.array(list(total.values()), dtype=np.float64))

    def scaled_space(self, values: Mapping[str, float]) -> ParameterSpace:
        """The parameters in units in which every column of the Jacobian is as long as the residuals."""
        space = self.layout.space
        moved = ParameterSpace(
            [replace(p, start=values[p.name]) if p.name in space.names else p for p in space.parameters]
        )
        if not moved.free:
            return moved
        lengths = self.lengths(values) * np.abs(moved.slopes(moved.start))
        size = math.sqrt(2.0 * self.value(values))
        if not np.any(lengths > 0) or not size > 0:
            return moved
        return moved.rescaled(size / np.maximum(lengths, 1e-9 * lengths.max()))

    def with_scales(self, values: Mapping[str, float]) -> dict[str, float]:
        """The values with each free scale set to its best for the given shape, by non-negative least squares (L2).

        Lobes whose square enters, and scales that channels share, keep their start.
        """
        from scipy.optimize import nnls

        found = dict(values)
        layout, free = self.layout, set(self.layout.space.names)
        for c in range(len(layout.channels)):
            own = layout.of_channel(values, c)
            names = [n for n, labels in layout.names.items() if labels[c] in free & layout.scale_names]
            names = [n for n in names if layout.names[n].count(layout.names[n][c]) == 1]
            weight = self.loss.root * self.loss.factor[:, c]
            rest = self._sum({**own, **dict.fromkeys(names, 0.0)})
            if not names:
                continue
            matrix = np.stack([self._by_scale({**own, n: 0.0}, n) * weight for n in names], axis=1)
            target = (self.data.value[:, c] - rest) * weight
            best, _ = nnls(matrix.T @ matrix, np.maximum(matrix.T @ target, 0.0))
            for n, scale in zip(names, best, strict=True):
                p = layout.space.by_name[layout.names[n][c]]
                room = 1e-3 * (p.high - p.low)
                found[p.name] = float(min(max(scale, p.low + room), p.high - room))
        return found
