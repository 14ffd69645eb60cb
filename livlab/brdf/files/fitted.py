"""A fitted model read back from the JSON that a fit was written to, so that it can be exported as tables are."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from livlab.brdf.files.interface import FileFunctions
from livlab.brdf.models.model import Model, model
from livlab.core.files import readable
from livlab.errors import DatasetError

FloatArray = npt.NDArray[np.float64]

LARGEST_BYTES = 1 << 24


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model with the parameters that a fit gave it.

    Attributes
    ----------
    model
        The model.
    parameters
        By name, one number a channel.
    channels
        Their names.
    exact
        True: it is known everywhere, so that it is converted without a table between.
    """

    model: Model
    parameters: dict[str, FloatArray]
    channels: tuple[str, ...]
    exact: bool = True

    @property
    def name(self) -> str:
        """The model's."""
        return self.model.name

    @property
    def source(self) -> str:
        """For a table made of it."""
        return f"fitted model {self.name}"

    def evaluate(self, wi: npt.ArrayLike, wo: npt.ArrayLike) -> FloatArray:
        """BRDF (..., channel) in 1/sr without cosine at directions (..., 3)."""
        return self.model.evaluate(wi, wo, self.parameters)

    def known(self, wi: npt.ArrayLike, wo: npt.ArrayLike) -> FloatArray:
        """The same: it is known everywhere."""
        return self.evaluate(wi, wo)


def read_fit(path: Path) -> Fitted:
    """A fit as `livlab brdf fit -o` or `BrdfFit.to_json` wrote it.

    Raises
    ------
    DatasetError
        No such file, no JSON of a fit, parameters that lack a value or a channel.
    InputError
        A model that does not exist, a parameter outside its bounds.
    """
    text = readable(path, "fit", LARGEST_BYTES, "Name the JSON of a fit.", DatasetError).read_bytes()
    try:
        record = json.loads(text)
        name, rows = str(record["model"]), [_row(row) for row in record["parameters"]]
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        remedy = "Name a file that `livlab brdf fit -o` wrote."
        raise DatasetError.of(
            path.name, "its content", f"is no fit ({type(error).__name__}: {error})", remedy
        ) from error
    which = model(name)
    channels = tuple(dict.fromkeys(channel for _, channel, _ in rows if channel)) or ("value",)
    known = {(base, channel): value for base, channel, value in rows}
    parameters = {}
    for p in which.parameters:
        found = [known.get((p.name, channel), known.get((p.name, ""))) for channel in channels]
        if any(value is None for value in found):
            raise DatasetError.of(path.name, p.name, f"has no value for each of {', '.join(channels)}", "Fit it again.")
        parameters[p.name] = np.array(found, dtype=np.float64)
    which.checked(parameters)
    return Fitted(which, parameters, channels)


def _row(row: Any) -> tuple[str, str, float]:
    label, channel, value = str(row["parameter"]), str(row["channel"]), float(row["value"])
    if not np.isfinite(value):
        raise ValueError(f"{label} is not finite")
    return label.removesuffix(f"[{channel}]") if channel else label, channel, value


FILE = FileFunctions(read_fit)
