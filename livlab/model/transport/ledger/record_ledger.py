"""The ledger: one recorded walk that answers for every absorption, and for nearby scattering.

Absorption only weighs a path, exp(−Σ µ_a,j ℓ_j) over the layers; a change of scattering weighs it by
Π (s'/s)ⁿ e^(−(s'−s) ℓ). `record` walks at a few anchor wavelengths and keeps, for each photon that leaves, its
path length and scatterings in every layer; `Ledger` answers from that: spectra, parameter sets, gradients.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.device import Variant
from livlab.model.transport.ledger.data import Detector
from livlab.model.transport.ledger.ledger import Ledger, load
from livlab.model.transport.ledger.walks import (
    MAX_STEPS,
    MOST_PHOTONS,
    RESERVE,
    RecordingRequest,
    RecordingTarget,
    make_recording,
)
from livlab.model.transport.source import Source
from livlab.model.transport.tally import Tally

__all__ = ["Detector", "Ledger", "load", "record"]


def record(
    stack: OpticalStack,
    *,
    samples: int | None = None,
    standard_error: float | None = None,
    relative: float | None = None,
    seed: int = 0,
    source: Source | None = None,
    tally: Tally | None = None,
    half_width_mm: float | None = None,
    also: Sequence[OpticalStack] = (),
    reserve: float = RESERVE,
    anchors: int | None = None,
    variant: Variant = "llvm",
    progress: Callable[[float], None] | None = None,
    max_steps: int = MAX_STEPS,
    check_bias: bool = True,
    most_photons: int = MOST_PHOTONS,
) -> Ledger:
    """Walk once, and keep what answers for all wavelengths of a stack.

    Each anchor is walked with an absorption a little below the least that is to be served: later weights
    e^(−(µ_a − µ_ref) ℓ) then never exceed one. The last layer, where it is endless to light, is kept in units of
    its mean free path and serves every scattering; the other layers serve scattering near an anchor's.

    Parameters
    ----------
    stack
        Layers and all wavelengths to be served, in any order. Phase functions are used at the anchors only.
    samples
        Photons at each anchor. Or:
    standard_error, relative
        Wanted standard error of the total reflectance at every wavelength, absolute or as a share of it; default
        1e-3 absolute.
    seed
        Natural number; the same seed gives the same ledger on one machine.
    source
        Default: a collimated pencil along the normal.
    tally
        Bins of exit angle and radius that are to be kept when the ledger is compressed. Radii need places, which
        are recorded only if it has `radius_edges`.
    half_width_mm
        Half the side of a square sample; None: endless layers.
    also
        Further stacks to be served, equal in layers and wavelengths' band but for their coefficients: they lower
        the reference absorption, and count in the accuracy.
    reserve
        Share by which the reference absorption stays below the least one served, in [0, 1).
    anchors
        Number of anchors; chosen from the change of phase functions, indices and scattering if not given.
    variant
        "llvm" or "cuda".
    progress
        Called with the fraction done; it may raise to stop.
    max_steps
        Collisions and interfaces after which a photon is given up (`residual`).
    check_bias
        Whether to solve half-way between anchors by `adding_doubling`, so that the bias of interpolation can be told
        (NaN if not).
    most_photons
        Photons in all at which recording stops even if the error is not met (`attrs` of answers tell it).

    Returns
    -------
    Ledger

    Raises
    ------
    InputError
        An argument out of bounds, a factor cos θ (its mean is zero) where places matter, layers that differ
        between the stacks, or scattering that changes too much over the band for the ledger.
    EnvironmentProblem
        The variant cannot run here.
    """
    if samples is None and relative is None and standard_error is None:
        standard_error = 1e-3
    request = RecordingRequest(
        RecordingTarget(samples, standard_error, relative),
        seed=seed,
        source=source or Source.collimated(),
        tally=tally or Tally(),
        half_width_mm=half_width_mm,
        also=also,
        reserve=reserve,
        anchors=anchors,
        variant=variant,
        progress=progress,
        max_steps=max_steps,
        check_bias=check_bias,
        most_photons=most_photons,
    )
    return make_recording(Ledger, stack, request)
