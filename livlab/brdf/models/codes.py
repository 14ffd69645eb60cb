"""Codes of Fresnel terms and distributions in the compiled kernels; apart, so that lobes need no compiler."""

from __future__ import annotations

from typing import NamedTuple

MIRROR, DIELECTRIC, CONDUCTOR, SCHLICK = range(4)
"""Codes of the Fresnel terms of `livlab.brdf.models.kernels.microfacet`."""

GGX, BECKMANN = range(2)
"""Codes of its distributions of normals."""


class Facets(NamedTuple):
    """A kind of microfacet surface; `correlated`: shadowing and masking are so by height."""

    distribution: int
    fresnel: int
    correlated: bool = False
