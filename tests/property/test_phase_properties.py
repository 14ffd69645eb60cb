"""Properties of tabulated phase functions and mixtures over drawn tables."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from livlab.model.tissue.phase.base import Phase
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Tabulated, mixture

U = np.linspace(0.0, 1.0, 257)[:-1]


@st.composite
def tables(draw: st.DrawFn) -> Tabulated:
    inner = draw(st.lists(st.floats(-9.0, 0.29), min_size=0, max_size=12, unique=True))
    w = np.unique(np.concatenate([[0.0], 10.0 ** np.array(inner), [2.0]]))
    p = np.array(draw(st.lists(st.floats(0.0, 1e6), min_size=w.size, max_size=w.size)))
    assume(p.max() > 1e-3)
    return Tabulated.from_complement(w, p)


@settings(max_examples=60, deadline=None)
@given(tables())
def test_a_table_is_a_distribution(phase: Tabulated) -> None:
    w = phase.quantile_complement(U)
    assert (np.diff(w) >= 0.0).all()
    assert np.abs(phase.cdf_complement(w) - U).max() < 1e-11
    assert (phase.pdf_complement(w) >= 0.0).all()
    chi = phase.legendre(40)
    assert abs(chi[1] - phase.anisotropy) < 1e-12
    assert (np.abs(chi) <= 1.0 + 1e-12).all()


@settings(max_examples=40, deadline=None)
@given(tables(), st.floats(-0.99, 0.9999), st.floats(1e-6, 1e6))
def test_a_mixture_is_a_distribution(table: Tabulated, g: float, weight: float) -> None:
    phase: Phase = mixture([table, HenyeyGreenstein(g)], [1.0, weight])
    mu = phase.sample(U)
    assert (np.diff(mu) >= 0.0).all()
    w = phase.quantile_complement(U)  # type: ignore[attr-defined]
    assert np.abs(phase.cdf_complement(w) - U).max() < 1e-11  # type: ignore[attr-defined]
    share = weight / (1.0 + weight)
    assert abs(phase.anisotropy - ((1.0 - share) * table.anisotropy + share * g)) < 1e-12
