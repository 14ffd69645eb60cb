"""Runners for the account of energy in every reading of the thesis."""

from __future__ import annotations

from typing import Any

import numpy as np

from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import reading as named_reading
from livlab.model.transport.adding_doubling import adding_doubling
from livlab.stress.cases_transport import closed
from livlab.stress.inputs import liver
from livlab.stress.measured import Measured, runner, values


@runner
def energy(
    reading: str,
    wavelength_nm: list[float],
    solver: str = "expected",
    samples: int = 0,
    half_width_mm: float | None = None,
    options: dict[str, Any] | None = None,
) -> dict[str, Measured]:
    """The account of the liver under a reading.

    `balance`: |reflected + transmitted + absorbed + lost + redirect loss + residual − 1|, the worst wavelength.
    `redirect_loss`: what Algorithm 2 takes from the light without any tissue absorbing it (0 where energy is
    conserved).
    """
    stack = liver(reading, wavelength_nm, options)
    if solver == "adding-doubling":
        r = adding_doubling(stack, tolerance=1e-4)
        return values(balance=np.abs(closed(r) - 1.0).max())
    from livlab.model.transport.walk.walk import Source, walk

    width = None if half_width_mm is None else float(half_width_mm)
    source = Source.collimated() if width is None else Source.collimated(square_half_width_mm=width)
    r = walk(
        stack,
        samples=samples,
        seed=11,
        estimator=solver,  # type: ignore[arg-type]
        half_width_mm=width,
        source=source,
    )
    return values(balance=np.abs(closed(r) - 1.0).max(), lost=float(r.lost.max() > 0)) | {
        "redirect_loss": Measured(r.redirect_loss.to_numpy(), r.redirect_loss_se.to_numpy())
    }


@runner
def clear_liver(wavelength_nm: list[float]) -> dict[str, Measured]:
    """The liver with every concentration at 0: clear plates, and nothing else.

    `rates`: the largest rate left; the rest as reflected and transmitted by adding–doubling and by the walk.
    """
    from livlab.model.transport.fresnel import incoherent_stack
    from livlab.model.transport.walk.walk import walk

    stack = optical_stack(_emptied(), named_reading("consistent"), wavelength_nm)
    rates = max(float(i.rate.max()) for layer in stack.layers for i in layer.interactions)
    exact = adding_doubling(stack)
    found = walk(stack, samples=200_000, seed=2)
    apart = []
    for k in range(len(wavelength_nm)):
        indices = [float(x) for x in (stack.n_above[k], *(y.n[k] for y in stack.layers), stack.n_below[k])]
        r, t = incoherent_stack(indices)
        apart.append(
            max(abs(float(exact.reflectance[k] + exact.specular[k]) - r), abs(float(exact.transmittance[k]) - t))
        )
    z = (found.reflectance - exact.reflectance) / found.reflectance_se
    return values(
        rates=rates,
        apart=max(apart),
        absorbed=float(exact.absorbed.sum() + found.absorbed.sum()),
        z=float(abs(z).max()),
    )


def _emptied() -> Any:
    """The liver without blood, bile, lipid, water, fibres and cells."""
    tissue = load_preset("liver")
    layers = []
    for layer in tissue.layers:
        elements = {n: e.with_share(0.0) if e.budget else e for n, e in layer.elements.items()}
        layers.append(layer.model_copy(update={"elements": elements, "profile": ()}))
    return tissue.model_copy(update={"layers": tuple(layers), "choices": ()})
