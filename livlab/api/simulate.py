"""One call for a tissue, one for its spectrum: the experiment is built and checked as a file's would be."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from livlab.api.arguments import explained
from livlab.api.curve import Spectrum
from livlab.config.load import check_experiment
from livlab.errors import InputError
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import READINGS, Reading
from livlab.model.tissue.tissue import Tissue, override

if TYPE_CHECKING:
    from pydantic import BaseModel

    from livlab.acquire.instruments.models import Instrument
    from livlab.kinds.spectral.config import SpectralExperiment
    from livlab.model.tissue.stack import OpticalStack

TissueLike = Tissue | str | Path | Mapping[str, Any]
"""A tissue, a preset's name, the path of a preset file (TOML), or a tissue written out as a table."""

Part = str | Mapping[str, Any]
"""A part of an experiment by its `kind` alone, or as the table that a file would have."""

PREVIEW = 0.005
"""Standard error of a spectrum as a share of its maximum, if none is said: seconds on two cores."""

ENDLESS = {"kind": "integrating-sphere", "sample_side_mm": "infinite", "port_diameter_mm": "infinite"}
"""All that is reflected: what two laboratories can compare, and what adding–doubling answers without noise."""

BAND_NM = tuple(float(x) for x in range(450, 701, 10))
"""Wavelengths of a spectrum if none are said: the visible, where every table of the liver has numbers."""


@explained
def tissue(
    name: TissueLike = "liver",
    *,
    state: str | None = None,
    variant: str = "whole",
    changes: Mapping[str, Any] | None = None,
) -> Tissue:
    """A tissue by the name of its preset, from a file of one's own, or written out; single values changed by path.

    Parameters
    ----------
    name
        See `TissueLike`.
    state, variant
        Of a preset; its default if not said.
    changes
        Value by path, e.g. {"layers.parenchyma.elements.blood.oxygenation": 0.6}.

    Raises
    ------
    ConfigError
        An unknown preset, state, variant or path, or a value that does not fit.

    Examples
    --------
    >>> tissue("liver", state="in_vivo")
    <Tissue human liver, in_vivo: capsule 0.085 mm, parenchyma 140 mm>
    """
    if isinstance(name, (str, Path)):
        return load_preset(name, state=state, variant=variant, changes=changes)
    if state is not None or variant != "whole":
        raise InputError.of("state", state or variant, "belongs to a preset, and this tissue is none", "Leave it out.")
    made = name if isinstance(name, Tissue) else Tissue.parse(name)
    return override(made, changes) if changes else made


@explained
def spectrum(
    tissue: TissueLike = "liver",
    reading: str | Reading = "measured",
    wavelengths_nm: ArrayLike | None = None,
    *,
    state: str | None = None,
    variant: str = "whole",
    changes: Mapping[str, Any] | None = None,
    instrument: Part | BaseModel | None = None,
    accuracy: float | Mapping[str, float] | None = None,
    solver: Part | BaseModel = "auto",
    effects: Literal["auto"] | Mapping[str, Any] | None = None,
    seed: int = 1,
    device: Literal["llvm", "cuda"] = "llvm",
    name: str | None = None,
) -> Spectrum:
    """What an instrument reads over a tissue; the numbers are those of `livlab run` on `result.to_toml()`.

    Parameters
    ----------
    tissue, state, variant, changes
        As `livlab.tissue`.
    reading
        "thesis", "consistent", "measured", or a `Reading` of one's own (docs/readings.md).
    wavelengths_nm
        (W,) rising, nm; 450–700 by 10 if not said.
    instrument
        All that is reflected from an endless sample, collected by an integrating sphere, if not said. Else "collinear",
        "integrating-sphere", "fibre-probe", "hyperspectral-camera", or a table with `kind` and settings.
    accuracy
        Wanted standard error: a number is a share of the curve's maximum (0.005 if not said); or a table with
        `relative`, `standard_error` or `seconds`.
    solver
        "auto" (the cheapest that meets the accuracy), "walk", "adding-doubling", or a table.
    effects
        "auto" leaves out what the scene does not call for (docs/effects.md); everything is simulated if not said.
    seed
        Of every draw.
    device
        Where a walk runs: processor or graphics card.
    name
        What plots call it; tissue and reading if not said.

    Returns
    -------
    `Spectrum`; its `data` holds the budget of the light and what it cost.

    Raises
    ------
    ConfigError, InputError
        What a file would be refused for.
    RangeError
        A wavelength outside the tables of the tissue.
    EnvironmentProblem
        A walk without a usable libLLVM.

    Examples
    --------
    >>> found = spectrum("liver", "measured", [500, 560, 640], variant="parenchyma_only", solver="adding-doubling")
    >>> bool(found.value[0] < found.value[2])  # blood absorbs green, not red
    True
    """
    from livlab.acquire.instruments.spectrometer import measure
    from livlab.kinds.shared.seeds import reading_seed
    from livlab.model.tissue.optics import optical_stack

    config = spectral_experiment(
        tissue, reading, wavelengths_nm, state=state, variant=variant, changes=changes, instrument=instrument,
        accuracy=accuracy, solver=solver, effects=effects, seed=seed, device=device,
    )  # fmt: skip
    own, chosen = config.all_readings[0], config.tissue.build()
    stack, looks = optical_stack(chosen, own, config.wavelengths.grid()), config.instrument
    said: tuple[str, ...] = ()
    if config.effects is not None:
        stack, looks, said = _simplified(config, chosen, stack)
    used = config.solver.with_seed(reading_seed(config.seed, own.name))
    data = measure(stack, looks, used, accuracy=config.accuracy, variant=config.variant)
    label = name or ", ".join(filter(None, (chosen.name, chosen.state.replace("_", " "), own.name)))
    noted = tuple(filter(None, str(data.attrs["notes"]).split("\n")))
    return Spectrum(
        data["wavelength"].to_numpy(),
        data["value"].to_numpy(),
        data["standard_error"].to_numpy(),
        label,
        (*said, *noted),
        data,
        config,
    )


def _simplified(
    config: SpectralExperiment, chosen: Tissue, stack: OpticalStack
) -> tuple[OpticalStack, Instrument, tuple[str, ...]]:
    """Stack and instrument without what the scene does not call for, and what was left out, in words."""
    from livlab.effects.plan import plan

    asked = config.effects
    assert asked is not None
    planned = plan(
        stack,
        config.instrument,
        asked.tolerance,
        asked.forced,
        tolerance_of=asked.tolerance_of,
        mode=asked.mode,
        tissue=chosen,
        reading=config.all_readings[0],
        literal=config.solver.literal,
    )
    said: tuple[str, ...] = ()
    if planned.dropped:
        left_out = ", ".join(planned.dropped)
        said = (f"Left out {left_out}; the value moves by at most {planned.bound:.2g}.",)
    return planned.reduced.stack, planned.instrument, said


def spectral_experiment(
    tissue: TissueLike,
    reading: str | Reading,
    wavelengths_nm: ArrayLike | None,
    *,
    state: str | None,
    variant: str,
    changes: Mapping[str, Any] | None,
    instrument: Part | BaseModel | None,
    accuracy: float | Mapping[str, float] | None,
    solver: Part | BaseModel,
    effects: Any,
    seed: int,
    device: str,
) -> SpectralExperiment:
    """The arguments of `spectrum` as an experiment, resolved."""
    from livlab.kinds.spectral.config import SpectralExperiment

    made = _tissue(tissue, state=state, variant=variant, changes=changes)
    data: dict[str, Any] = {
        "kind": "spectral",
        "name": "spectrum",
        "seed": seed,
        "tissue": {"inline": made},
        "wavelengths": {"list_nm": wavelength_list(wavelengths_nm)},
        "instrument": part("instrument", ENDLESS if instrument is None else instrument),
        "variant": device,
        # A curve of one or two points cannot be smoothed, and a call asks for no curve.
        "processing": {"moving_average": 1, "interpolate_nm": 1000.0, "normalise": "none"},
        **readings_of(reading),
        **_solver(solver, accuracy),
    }
    if effects is not None:
        data["effects"] = effects
    grid = data["wavelengths"]["list_nm"]
    if len(grid) > 1 and grid[-1] > grid[0]:
        data["processing"]["interpolate_nm"] = (grid[-1] - grid[0]) / 10
    found = check_experiment(data, source="livlab.spectrum").resolve()
    assert isinstance(found, SpectralExperiment)
    return found


def readings_of(reading: str | Reading) -> dict[str, Any]:
    """A reading as an experiment has it: by name, or with options of its own."""
    if isinstance(reading, Reading):
        return {"reading": [reading]}
    if not isinstance(reading, str):
        raise InputError.of("reading", reading, f"must be one of {', '.join(READINGS)}, or a Reading", "Name one.")
    return {"readings": [reading]}


def part(what: str, given: Part | BaseModel) -> Any:
    """A part of an experiment: its kind alone, a table, or the checked object itself."""
    if isinstance(given, str):
        return {"kind": given}
    if isinstance(given, Mapping):
        if "kind" not in given:
            raise InputError.of(what, dict(given), "needs its kind", f"Add kind = '…' to the {what}.")
        return dict(given)
    return given


def wavelength_list(wavelengths_nm: ArrayLike | None) -> list[float]:
    """Wavelengths as plain numbers; the default band if none are said."""
    if wavelengths_nm is None:
        return list(BAND_NM)
    try:
        grid = np.atleast_1d(np.asarray(wavelengths_nm, dtype=np.float64))
    except (TypeError, ValueError):
        raise InputError.of("wavelengths_nm", wavelengths_nm, "must be numbers", "Give wavelengths in nm.") from None
    if grid.ndim != 1:
        raise InputError.of("wavelengths_nm", grid.shape, "must have one dimension", "Give a list of wavelengths.")
    if grid.size and grid.min() > 0 and grid.max() < 31.0:  # no table of a tissue reaches there
        raise InputError.of("wavelengths_nm", grid.tolist(), "look like micrometres", "Give nm: 1000 times as much.")
    return [float(x) for x in grid]


def _tissue(given: TissueLike, *, state: str | None, variant: str, changes: Mapping[str, Any] | None) -> Tissue:
    return tissue(given, state=state, variant=variant, changes=changes)


def _solver(solver: Part | BaseModel, accuracy: float | Mapping[str, float] | None) -> dict[str, Any]:
    """Solver and accuracy as an experiment has them: a walk takes the wish as its own rule."""
    wish: dict[str, float] | None
    if accuracy is None:
        wish = {"relative": PREVIEW} if solver in ("auto", "walk") else None
    elif isinstance(accuracy, Mapping):
        wish = {str(k): float(v) for k, v in accuracy.items()}
    else:
        wish = {"relative": _share(accuracy)}
    auto = solver == "auto" or (isinstance(solver, Mapping) and solver.get("kind") == "auto")
    if wish is None or auto:
        return {"solver": part("solver", solver)} | ({"accuracy": wish} if wish else {})
    if solver == "walk":
        rules = {"seconds": "max_seconds"}
        return {"solver": {"kind": "walk", **{rules.get(k, k): v for k, v in wish.items()}}}
    shown = solver if isinstance(solver, str) else "solver with settings"
    raise InputError.of(
        "accuracy", accuracy, f"goes with solver 'auto' or 'walk', not with {shown}",
        "Give the solver its own setting: {'kind': 'adding-doubling', 'tolerance': 1e-6}.",
    )  # fmt: skip


def _share(accuracy: Any) -> float:
    if isinstance(accuracy, bool) or not isinstance(accuracy, (int, float, np.floating)):
        raise InputError.of("accuracy", accuracy, "must be a number or a table", "Give 0.002, say.")
    return float(accuracy)
