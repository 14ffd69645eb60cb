"""A tissue of two layers that the ledger's tests walk through."""

import math

import numpy as np

from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic
from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer

W = np.linspace(500.0, 700.0, 9)
ONE = np.ones_like(W)


def layer(name, thickness, n, mua, mus, g, **options):
    n, mua, mus, g = (np.broadcast_to(np.asarray(x, float), W.shape) for x in (n, mua, mus, g))
    phases = tuple(HenyeyGreenstein(float(x)) if x else Isotropic() for x in g)
    parts = (
        Interaction("blood", np.array(mua), 0 * ONE, phases),
        Interaction("cells", np.array(mus), ONE, phases, **options),
    )
    return PlaneLayer(name, thickness, np.array(n), parts)


def stack(*layers, above=1.0, below=1.0):
    return OpticalStack(W, tuple(layers), above * ONE, below * ONE, "made up")


def tissue(mua=1.0, mus=1.0, thickness=0.1, g=0.8):
    falling = np.linspace(1.0, 0.1, W.size)
    capsule = layer("capsule", thickness, 1.36, 0.02 * mua, 12.0 * mus * (W / 600.0) ** -0.5, 0.9)
    bulk = layer("bulk", math.inf, 1.38, 0.5 * mua * falling, 10.0 * mus * (W / 600.0) ** -1.0, g)
    return stack(capsule, bulk)
