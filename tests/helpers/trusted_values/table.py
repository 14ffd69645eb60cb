"""Compute the trusted values of the catalogue anew and store them in `livlab/stress/trusted.csv`.

Closed forms and series in 25 to 50 digits and more (mpmath, a development dependency), and adding–doubling at
64 nodes. What is stored has 17 digits, the most a double can use.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from typing import Any

from livlab.stress.catalogue import COLUMNS, TRUSTED, Case, cases

from . import forms, scatterers, transport
from .precise import mpmath

REFERENCES: dict[str, tuple[Callable[..., dict[str, list[Any]]], str]] = {
    "sphere": (scatterers.sphere, "Mie series, 50 digits and more"),
    "cylinder": (scatterers.cylinder, "boundary conditions solved, 60 digits and more"),
    "cylinder_mean": (scatterers.cylinder_mean, "boundary conditions solved, 60 digits, Gauss's rule in ζ"),
    "fresnel": (forms.fresnel, "closed form, 50 digits"),
    "diffuse_fresnel": (forms.diffuse_fresnel, "quadrature, 25 digits"),
    "plates": (forms.plates, "closed form, 50 digits"),
    "packaging": (forms.packaging, "closed form, 50 digits"),
    "spheroid": (forms.spheroid, "closed form, 50 digits"),
    "penalised": (forms.penalised, "closed form, 350 digits"),
    "quantile": (forms.quantile, "closed form, 700 digits"),
    "peak": (forms.peak, "closed form, 50 digits"),
    "pearson": (forms.pearson, "definition, 50 digits"),
    "beer": (forms.beer, "closed form, 50 digits"),
    "half_space": (transport.half_space, "H function, 25 digits"),
    "thin_slab": (transport.thin_slab, "single scattering, 25 digits"),
    "thick_slab": (transport.thick_slab, "diffusion limit, 25 digits"),
    "adding_doubling": (transport.adding_doubling, "adding–doubling, 64 nodes"),
    "redirect_loss": (transport.redirect_loss, "adding–doubling, 32 nodes"),
    "kubelka_munk_layer": (transport.kubelka_munk_layer, "closed form, 400 digits"),
    "dipole": (transport.dipole, "closed form, 50 digits, and quadrature, 25"),
}
"""References by name, and what a reader is told of them."""

DIGITS = 17
HOW = frozenset({"samples", "seed", "estimator", "source", "max_steps"})
"""Arguments that say how a runner works, not on what: no reference wants them."""


def compute(case: Case) -> list[tuple[str, str, int, str, str]]:
    """Rows (case, quantity, index, value, by) of one case."""
    rows = []
    for name in dict.fromkeys(e.reference for e in case.expect if e.reference):
        function, by = REFERENCES[name]
        found = function(**{k: v for k, v in case.trusted_args.items() if k not in HOW})
        for e in case.expect:
            if e.reference == name:
                rows += [(case.name, e.quantity, k, _text(x), e.by or by) for k, x in enumerate(found[e.name])]
    return rows


def main(pattern: str = "") -> int:
    """Compute the cases that match, keep the others, write the file."""
    known: dict[str, list[tuple[Any, ...]]] = {}
    if TRUSTED.exists():
        with TRUSTED.open(newline="", encoding="utf-8") as stream:
            for row in csv.DictReader(stream):
                known.setdefault(row["case"], []).append(tuple(row[c] for c in COLUMNS))
    try:
        for case in cases():
            if pattern in case.name:
                known[case.name] = list(compute(case))
                print(f"{case.name}: {len(known[case.name])} values", flush=True)
    finally:
        with TRUSTED.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream)
            writer.writerow(COLUMNS)
            for case in cases():
                writer.writerows(known.get(case.name, []))
    return 0


def _text(value: Any) -> str:
    if isinstance(value, float):
        return repr(value)
    return str(mpmath().nstr(value, DIGITS, strip_zeros=True, min_fixed=-3, max_fixed=3))
