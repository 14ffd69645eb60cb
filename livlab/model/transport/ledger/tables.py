"""A ledger's answers as tables: parameter sets, spectra under the walk's names, gradients by tissue parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr

from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.ledger.data import Coefficients, Detector, Side
from livlab.model.transport.ledger.plan import LARGEST_DEGENERACY, specular
from livlab.model.transport.ledger.recording import LEAST_SAMPLES, Answer, Recording, WhenDegenerate
from livlab.model.transport.ledger.walks import RecordingRequest, RecordingTarget, make_recording
from livlab.units import FloatArray

INDEX_TOLERANCE = 2e-3
ANISOTROPY_TOLERANCE = 0.05
"""Largest change of an index, and of ln(1 − g), from what was recorded at a wavelength."""

_SIDES: dict[str, Side] = {"reflectance": "up", "transmittance": "down", "lost": "side", "residual": "residual"}
_MEANING = {
    "reflectance": "light that leaves through the top, without the specular reflection",
    "transmittance": "light that leaves through the bottom",
    "lost": "light that leaves through the sides",
    "residual": "light of photons given up before they ended",
    "specular": "Fresnel reflection at the first surface",
    "taken": "light absorbed in all layers together, or removed by the redirect factor of Algorithm 2",
    "ess": "effective sample size of the reflectance",
    "degeneracy": "weight degeneracy: log of the variance added by reweighting",
    "valid": "whether the ledger can answer",
}


def settings_of(
    ledger: Recording, absorption: Any, scattering: Any, wavelength_nm: Any, anisotropy: Any
) -> Coefficients:
    """Checked arrays as settings."""
    a = np.atleast_2d(np.asarray(absorption, dtype=np.float64))
    s = np.atleast_2d(np.asarray(scattering, dtype=np.float64))
    layers = len(ledger.layers)
    for name, x in (("absorption", a), ("scattering", s)):
        if x.ndim != 2 or x.shape[1] != layers:
            raise InputError.of(name, x.shape, f"must be (S, {layers}), one column a layer", "Mend the shape.")
        if not (np.isfinite(x) & (x >= 0)).all():
            raise InputError.of(name, float(x.min()), "must be finite and >= 0", "Mend the value.")
    if len(a) != len(s) and 1 not in (len(a), len(s)):
        raise InputError.of("scattering", s.shape, f"does not fit absorption {a.shape}", "Give one row a set.")
    a, s = (np.array(x) for x in np.broadcast_arrays(a, s))
    if wavelength_nm is None:
        wavelength_nm = 0.5 * (ledger.served.wavelength_nm[0] + ledger.served.wavelength_nm[-1])
    base = ledger.served.at(np.broadcast_to(np.asarray(wavelength_nm, dtype=np.float64), (len(a),)))
    g = base.anisotropy
    if anisotropy is not None:
        g = np.array(np.broadcast_to(np.asarray(anisotropy, dtype=np.float64), a.shape))
        if not (np.isfinite(g) & (g > -1) & (g < 1)).all():
            raise InputError.of("anisotropy", float(g.max()), "must be within (−1, 1)", "Mend the value.")
    if ledger.scaled and not (s[:, -1] > 0).all():
        raise InputError.of(
            "scattering", 0.0, "must be > 0 in the last, endless layer", "Record a stack that is clear there."
        )
    return replace(base, absorption=a, scattering=s, anisotropy=g)


def fitted(ledger: Recording, stack: OpticalStack) -> Coefficients:
    """A stack's coefficients as the ledger can serve them."""
    sets = Coefficients.of(stack)
    if len(stack.layers) != len(ledger.layers):
        raise InputError.of(
            "stack", len(stack.layers), f"the ledger has {len(ledger.layers)} layers", "Record a ledger of this one."
        )
    own, given = ledger.served.thickness_mm, sets.thickness_mm
    if ledger.positions or math.isfinite(ledger.about["half_width_mm"]):
        if not np.array_equal(own, given):
            raise InputError.of("stack.thickness_mm", given.tolist(), "differs, and places matter", "Record anew.")
    elif np.isinf(own[-1]) != np.isinf(given[-1]):
        raise InputError.of("stack.thickness_mm", float(given[-1]), f"was {own[-1]:g}", "Record anew.")
    off = float(np.abs(sets.index - ledger.served.at(sets.wavelength_nm).index).max())
    if off > INDEX_TOLERANCE:
        raise InputError.of("stack.n", off, f"indices differ by more than {INDEX_TOLERANCE}", "Record this stack.")
    if ledger.scaled and not (sets.scattering[:, -1] > 0).all():
        raise InputError.of("stack", 0.0, "must scatter in the last, endless layer", "Record this stack.")
    return sets.fitted(own)


def unit_tangents(size: int, layers: int) -> list[tuple[FloatArray, FloatArray]]:
    """A change of one layer's absorption, for each layer, then of one layer's scattering."""
    zero = np.zeros((size, layers))
    units = [zero + row for row in np.eye(layers)]
    return [(one, zero) for one in units] + [(zero, one) for one in units]


def refuse(found: Answer, sets: Coefficients, least_samples: float) -> None:
    """Raise if any setting is not valid, naming the first and why.

    Raises
    ------
    InputError
    """
    bad = np.flatnonzero(~found.valid)
    if not bad.size:
        return
    k = int(bad[0])
    raise InputError.of(
        "ledger",
        f"{bad.size} of {len(sets)} settings, first at {sets.wavelength_nm[k]:g} nm",
        f"cannot be answered: effective samples {found.effective_samples[k]:.0f} (wanted {least_samples:g}), "
        f"added log variance {found.degeneracy[k]:.2g} (at most {LARGEST_DEGENERACY:g}), "
        "or optics beyond what was recorded or compressed",
        "Record more photons, or with these coefficients served.",
    )


def attributes(ledger: Recording) -> dict[str, Any]:
    """What every answer says about its ledger."""
    kept = ("seed", "variant", "stack", "digest", "seconds", "compile_seconds", "interpolation_bias")
    return {
        **{k: ledger.about[k] for k in kept},
        "estimator": "ledger",
        "samples": ledger.photons,
        "anchors_nm": ledger.anchors.wavelength_nm.tolist(),
        "degree": ledger.degree,
        "depth_bias": ledger.depth_bias,
        "compression_error": ledger.compression.error if ledger.compression else 0.0,
    }


def evaluation(ledger: Recording, found: Answer, sets: Coefficients, gradient: bool) -> xr.Dataset:
    """Answers on `set`."""
    layers = ledger.layers
    out = xr.Dataset(
        {
            "value": ("set", found.value, {"units": "1"}),
            "value_se": ("set", found.standard_error, {"units": "1"}),
            "ess": ("set", found.effective_samples, {"long_name": "effective sample size"}),
            "degeneracy": ("set", found.degeneracy, {"long_name": _MEANING["degeneracy"]}),
            "valid": ("set", found.valid),
        },
        coords={"wavelength": ("set", sets.wavelength_nm, {"units": "nm"}), "layer": list(layers)},
        attrs=attributes(ledger),
    )
    if gradient:
        n, dims = len(layers), ("set", "layer")
        for name, value, error in (
            ("d_absorption", found.by_absorption, found.slope_error[:n].T),
            ("d_scattering", found.by_scattering, found.slope_error[n:].T),
        ):
            out[name] = (dims, value, {"units": "mm"})
            out[f"{name}_se"] = (dims, error, {"units": "mm"})
    return out


def spectrum(
    ledger: Recording, sets: Coefficients, stack: OpticalStack | None, degenerate: WhenDegenerate, least_samples: float
) -> xr.Dataset:
    """Answers on `wavelength`, as `Ledger.spectrum` describes them."""
    base = ledger.served.at(sets.wavelength_nm)
    known = np.abs(np.log1p(-sets.anisotropy) - np.log1p(-base.anisotropy)).max(axis=1) <= ANISOTROPY_TOLERANCE
    answers = {name: ledger.answer(sets, Detector.total(s), (), least_samples) for name, s in _SIDES.items()}
    first = answers["reflectance"]
    valid = first.valid & known
    if degenerate == "raise":
        refuse(replace(first, valid=valid), sets, least_samples)
    data: dict[str, FloatArray] = {}
    for name, found in answers.items():
        data[name], data[f"{name}_se"] = found.value, found.standard_error
    data["specular"] = specular(sets.index, ledger.source)
    data["taken"] = 1.0 - data["specular"] - sum(found.value for found in answers.values())
    data |= {"ess": first.effective_samples, "degeneracy": first.degeneracy, "valid": valid}
    out = xr.Dataset(
        {n: ("wavelength", v, {"units": "1", "long_name": _MEANING.get(n, n)}) for n, v in data.items()},
        coords={"wavelength": ("wavelength", sets.wavelength_nm, {"units": "nm"})},
        attrs=attributes(ledger),
    )
    if ledger.tally.binned:
        out = _binned(ledger, sets, out)
    if degenerate == "walk" and stack is not None and not valid.all():
        out = _walked(ledger, stack, out, np.flatnonzero(~valid))
    return out


def _binned(ledger: Recording, sets: Coefficients, out: xr.Dataset) -> xr.Dataset:
    tally = ledger.tally
    for name, edges, unit in (("theta_o", tally.theta, "rad"), ("radius", tally.radius, "mm")):
        middle = [0.5 * (a + b) for a, b in pairwise(edges)]
        out = out.assign_coords({name: (name, middle, {"units": unit, "edges": list(edges)})})
    shape = (len(sets), len(tally.theta) - 1, len(tally.radius) - 1)
    for name in ("reflectance", "transmittance"):
        value, error = np.zeros(shape), np.zeros(shape)
        for t, theta in enumerate(pairwise(tally.theta)):
            for r, radius in enumerate(pairwise(tally.radius)):
                found = ledger.answer(sets, Detector(_SIDES[name], theta, radius))
                value[:, t, r], error[:, t, r] = found.value, found.standard_error
        dims = ("wavelength", "theta_o", "radius")
        out[f"{name}_binned"], out[f"{name}_binned_se"] = (dims, value), (dims, error)
    return out


def _walked(ledger: Recording, stack: OpticalStack, out: xr.Dataset, bad: np.ndarray[Any, Any]) -> xr.Dataset:
    """Answers at some wavelengths from a ledger recorded for them."""
    half = float(ledger.about["half_width_mm"])
    errors = out["reflectance_se"].to_numpy()[out["valid"].to_numpy()]
    request = RecordingRequest(
        RecordingTarget(standard_error=float(max(errors.max(), 1e-6)) if errors.size else 1e-3),
        seed=int(ledger.about["seed"]) + 1,
        source=ledger.source,
        tally=ledger.tally,
        half_width_mm=None if math.isinf(half) else half,
        variant=ledger.about["variant"],
    )
    made = make_recording(Recording, stack.at(bad.tolist()), request)
    again = spectrum(made, made.served, None, "mark", LEAST_SAMPLES)
    order = np.argsort(stack.wavelength_nm[bad], kind="stable")
    for name, values in again.data_vars.items():
        out[name].data[bad[order]] = values.data
    out.attrs["walked_again_nm"] = stack.wavelength_nm[bad].tolist()
    out.attrs["samples_walked_again"] = again.attrs["samples"]
    return out


def parameter_gradient(
    ledger: Recording,
    make: Callable[[Mapping[str, float]], OpticalStack],
    parameters: Mapping[str, float],
    step: float,
    detector: Detector,
) -> xr.Dataset:
    """Derivatives by tissue parameters, as `Ledger.gradient` describes them."""
    if not parameters or not 0.0 < step < 0.5:
        raise InputError.of("step", step, "must be within (0, 0.5), for at least one parameter", "Give 1e-3.")
    centre = fitted(ledger, make(parameters))
    tangents = []
    for name, value in parameters.items():
        h = step * abs(value) if value else step
        high, low = (fitted(ledger, make({**parameters, name: value + d})) for d in (h, -h))
        by_g = (high.anisotropy - low.anisotropy) / (2 * h)
        # Scattering acts by s (1 − g): a change of g is one of s.
        turned = centre.scattering * by_g / (1.0 - centre.anisotropy)
        by_s = (high.scattering - low.scattering) / (2 * h) - turned
        tangents.append(((high.absorption - low.absorption) / (2 * h), by_s))
    found = ledger.answer(centre, detector, tangents)
    dims = ("parameter", "wavelength")
    return xr.Dataset(
        {
            "gradient": (dims, found.slope),
            "gradient_se": (dims, found.slope_error),
            "value": ("wavelength", found.value, {"units": "1"}),
            "value_se": ("wavelength", found.standard_error, {"units": "1"}),
            "valid": ("wavelength", found.valid),
        },
        coords={
            "parameter": list(parameters),
            "wavelength": ("wavelength", centre.wavelength_nm, {"units": "nm"}),
        },
        attrs=attributes(ledger),
    )
