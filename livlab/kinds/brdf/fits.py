"""Fits of a BRDF experiment: from its file to `livlab.brdf.fit.fit`, and back to rows of a table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from livlab.config.errors import nearest
from livlab.errors import InputError
from livlab.kinds.brdf.config import FitSpec

if TYPE_CHECKING:
    import xarray as xr

    from livlab.brdf.fit.fit import BrdfFit

COLUMNS = (
    "model", "loss", "parameter", "value", "low", "high", "status", "true", "relative_error", "relative_rmse",
    "over_noise", "p", "adequate", "misfit", "seconds", "warning",
)  # fmt: skip
LEVEL = 0.95
REPLICATES = 200


def known_model(spec: FitSpec, true: Mapping[str, float]) -> None:
    """See that a fit names a model that there is, and parameters that it has.

    Raises
    ------
    InputError
        An unknown lobe or parameter.
    """
    from livlab.brdf.models.model import model

    known = [p.name for p in model(spec.model).parameters]
    for field, names in (("fit.fixed", spec.fixed), ("fit.free", spec.free), ("true", true)):
        for name in names:
            if name.partition("[")[0] not in known:
                hint = nearest(name, known) or f"It has {', '.join(known)}."
                raise InputError.of(field, name, f"{spec.model} has no such parameter", hint)


def fit_samples(samples: xr.Dataset, spec: FitSpec, *, seed: int) -> BrdfFit:
    """Fit a model as an experiment asks; its warnings stay in the result."""
    from livlab.brdf.fit.fit import fit

    return fit(
        samples,
        spec.model,
        loss=spec.loss,
        footprint="auto" if spec.footprint else None,
        fixed={name: np.asarray(value, dtype=float) for name, value in spec.fixed.items()},
        free=spec.free,
        starts=spec.starts,
        level=LEVEL,
        replicates=REPLICATES,
        seed=seed,
        warn=False,
    )


def relative_error(found: BrdfFit, true: Mapping[str, float], parameter: str) -> float | None:
    """Value / true − 1 of a parameter, the largest over its channels; None where the truth is not known."""
    base, _, channel = parameter.partition("[")
    errors = []
    for name, value in found.values.items():
        known = _true(true, name)
        if known and name.partition("[")[0] == base and (not channel or name == parameter):
            errors.append(value / known - 1.0)
    return max(errors, key=abs) if errors else None


def fit_rows(found: BrdfFit, spec: FitSpec, true: Mapping[str, float]) -> list[dict[str, object]]:
    """One row a parameter that was fitted."""
    rows: list[dict[str, object]] = []
    for name, row in found.table.iterrows():
        if row["status"] == "fixed":
            continue
        value, known = float(row["value"]), _true(true, str(name))
        rows.append(
            {
                "model": found.model.name,
                "loss": spec.loss,
                "parameter": name,
                "value": value,
                "low": float(row["lower"]),
                "high": float(row["upper"]),
                "status": row["status"] if row["held"] else "not held by itself",
                "true": known,
                "relative_error": value / known - 1.0 if known else None,
                "relative_rmse": found.relative_rmse,
                "over_noise": found.misfit.ratio,
                "p": found.misfit.worst,
                "adequate": found.misfit.adequate,
                "misfit": None if rows else found.misfit.words,
                "seconds": found.seconds,
                "warning": None if rows else ("; ".join(w for w in found.warnings if w != found.misfit.words) or None),
            }
        )
    return rows


def _true(true: Mapping[str, float], name: str) -> float | None:
    return true.get(name, true.get(name.partition("[")[0]))
