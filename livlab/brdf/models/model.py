"""BRDF models as sums of lobes with named parameters; `wi` to the light, `wo` to the eye, no cosine, 1/sr."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from livlab.brdf.angles import unit_directions
from livlab.brdf.models.lobes import LOBES, SUMS, Cosines, Lobe, ModelParameter
from livlab.errors import InputError
from livlab.units import FloatArray

__all__ = ["LOBES", "SUMS", "Cosines", "Lobe", "Model", "ModelParameter", "cosines", "model", "models"]


@dataclass(frozen=True)
class Model:
    """A BRDF: the sum of its lobes. Lobes that name the same parameter share it.

    Attributes
    ----------
    name
        Names of its lobes joined by +, or the name of a known sum.
    lobes
        The terms.
    """

    name: str
    lobes: tuple[Lobe, ...]

    @property
    def parameters(self) -> tuple[ModelParameter, ...]:
        """Its parameters, each once."""
        found = {p.name: p for lobe in reversed(self.lobes) for p in reversed(lobe.parameters)}
        order = dict.fromkeys(p.name for lobe in self.lobes for p in lobe.parameters)
        return tuple(found[name] for name in order)

    @property
    def reciprocal(self) -> bool:
        """Whether f(wi, wo) = f(wo, wi)."""
        return all(lobe.reciprocal for lobe in self.lobes)

    @property
    def domain(self) -> str:
        """Where it may be used, in words."""
        return "; ".join(f"{lobe.name}: {lobe.domain}" for lobe in self.lobes)

    def defaults(self) -> dict[str, float]:
        """Start values by name."""
        return {p.name: p.parameter.start_value for p in self.parameters}

    def evaluate(self, wi: ArrayLike, wo: ArrayLike, parameters: Mapping[str, ArrayLike]) -> FloatArray:
        """Values of the BRDF in 1/sr, without the cosine; zero where wi or wo lies below the surface.

        Parameters
        ----------
        wi, wo
            (..., 3) unit vectors in the local frame, z the normal; they broadcast.
        parameters
            By name, a number each or (channels,) numbers; missing ones take their defaults.

        Returns
        -------
        (...) array, or (..., channels) where a parameter has channels.

        Raises
        ------
        InputError
            Directions that are no unit vectors; a parameter that the model does not have, or outside its bounds;
            channels that do not agree.

        Examples
        --------
        >>> up = [0.0, 0.0, 1.0]
        >>> round(float(model("lambert").evaluate(up, up, {"kd": 0.5})), 6)
        0.159155
        """
        a, b = np.broadcast_arrays(unit_directions("wi", wi), unit_directions("wo", wo))
        values, channels = self.checked(parameters)
        at = cosines(a.reshape(-1, 3), b.reshape(-1, 3))
        found = np.stack([self.at(at, {n: float(v[c]) for n, v in values.items()}) for c in range(channels or 1)], -1)
        shape = (*a.shape[:-1], channels) if channels else a.shape[:-1]
        return found.reshape(shape)

    def at(self, cosines: Cosines, values: Mapping[str, float]) -> FloatArray:
        """Values (n,) from the three cosines, unchecked: for inner loops."""
        total = np.zeros(cosines.i.size)
        for lobe in self.lobes:
            scale = 1.0 if lobe.scale is None else values[lobe.scale]
            total += scale * lobe.basis(cosines, values)
            second = lobe.second(cosines, values)
            if second is not None:
                total += scale * scale * second
        return total

    def checked(self, parameters: Mapping[str, ArrayLike]) -> tuple[dict[str, FloatArray], int]:
        """Parameters as (channels,) arrays, and the number of channels, 0 if all are plain numbers.

        Raises
        ------
        InputError
            As `evaluate`.
        """
        known = {p.name: p.parameter for p in self.parameters}
        unknown = sorted(set(parameters) - set(known))
        if unknown:
            raise InputError.of("parameters", unknown, f"{self.name} has no such", f"It has {list(known)}.")
        arrays = {n: np.asarray(parameters.get(n, known[n].start_value), dtype=np.float64) for n in known}
        counts = {a.size for a in arrays.values() if a.ndim} - {1}
        if len(counts) > 1 or any(a.ndim > 1 for a in arrays.values()):
            shapes = {n: a.shape for n, a in arrays.items()}
            raise InputError.of("parameters", shapes, "have channels that do not agree", "Give one length throughout.")
        channels = counts.pop() if counts else 1 if any(a.ndim for a in arrays.values()) else 0
        for n, a in arrays.items():
            if not np.all((a >= known[n].low) & (a <= known[n].high)):
                bound = f"must lie within [{known[n].low:g}, {known[n].high:g}]"
                raise InputError.of(f"parameters.{n}", a.tolist(), bound, "Correct the value.")
        return {n: np.broadcast_to(a, max(channels, 1)) for n, a in arrays.items()}, channels


def cosines(wi: FloatArray, wo: FloatArray) -> Cosines:
    """The three cosines of (n, 3) unit vectors in the local frame."""
    io = np.einsum("ni,ni->n", wi, wo)
    return Cosines(np.ascontiguousarray(wi[:, 2]), np.ascontiguousarray(wo[:, 2]), io)


def model(name: str | Model | Sequence[str]) -> Model:
    """A model by the name of a lobe, of a known sum, or of lobes joined by + ("lambert+ggx", "lambert+ggx+ggx").

    A lobe that comes a second time has a 2 behind each of its parameters' names.

    Raises
    ------
    InputError
        A lobe that does not exist.

    Examples
    --------
    >>> [p.name for p in model("lambert+ggx+ggx").parameters]
    ['kd', 'ks', 'alpha', 'eta', 'ks2', 'alpha2', 'eta2']
    """
    if isinstance(name, Model):
        return name
    parts = tuple(part.strip() for part in name.split("+")) if isinstance(name, str) else tuple(name)
    label = "+".join(parts)
    parts = tuple(lobe for part in parts for lobe in SUMS.get(part, (part,)))
    lobes, seen = [], dict[str, int]()
    scales: set[str | None] = set()
    for part in parts:
        if part not in LOBES:
            raise InputError.of(
                "model", part, "is no lobe", f"Choose from {', '.join(sorted(LOBES))}; or {', '.join(sorted(SUMS))}."
            )
        # A second lobe of a kind, or one whose scale is taken, has a number behind each of its parameters' names.
        seen[part] = seen.get(part, 0) + 1
        number = seen[part]
        lobe = LOBES[part] if number == 1 else LOBES[part].renamed(str(number))
        while lobe.scale is not None and lobe.scale in scales:
            number += 1
            lobe = LOBES[part].renamed(str(number))
        scales.add(lobe.scale)
        lobes.append(lobe)
    return Model(label, tuple(lobes))


def models() -> pd.DataFrame:
    """A table of every lobe and named sum: parameters, reciprocity, domain, source."""
    rows = []
    for name in (*LOBES, *SUMS):
        one = model(name)
        rows.append(
            {
                "model": name,
                "parameters": ", ".join(p.name for p in one.parameters),
                "reciprocal": one.reciprocal,
                "domain": one.domain,
                "source": "; ".join(dict.fromkeys(lobe.source for lobe in one.lobes)),
            }
        )
    return pd.DataFrame(rows).set_index("model")
