"""Does a fitted model describe its data to the noise, and where does it miss? Numbers only: no model, no instrument.

Everything rests on z, the residuals over their standard deviations, and on J, the derivatives of z by the fitted
parameters. Where the model is right, z after its part along J is a projection of noise: its squares add up to χ² with
n − rank J degrees of freedom, and offsets of groups of residuals (one light, one stretch of wavelengths) explain no
more of it than chance (the F test of nested linear models; Seber & Lee 2003, section 4.3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from livlab.errors import InputError
from livlab.optimise.structure import LIMIT, Grouping, Structure, by_groups, runs_p
from livlab.units import FloatArray

CAVEAT = "the intervals hold only if the model is right"
"""What every sentence about a model that misses its data ends with."""

LOST = 1e-12
"""Share of the largest eigenvalue of the scaled JᵀJ below which a direction counts as not there."""


@dataclass(frozen=True)
class Misfit:
    """How far a fitted model misses its data.

    Attributes
    ----------
    chi2, dof, p
        Σ z² after the model's own directions, its degrees of freedom, and the chance of a larger one with a right
        model; p is nan where the noise is not known, chi2 then in units of nothing.
    ratio
        √(chi2/dof): the residuals over the noise; nan where that is not known.
    noise
        Where the noise is known from, in words.
    structure
        Tests of what residuals may hang on.
    where, where_ratio
        The group with the largest residuals over all groupings, and these over the noise.
    relative
        Residual over signal, for readers: nan if not given.
    """

    chi2: float
    dof: float
    p: float
    ratio: float
    noise: str
    structure: tuple[Structure, ...] = ()
    where: str = ""
    where_ratio: float = math.nan
    relative: float = math.nan

    @property
    def known(self) -> bool:
        """Whether the noise is known."""
        return math.isfinite(self.p)

    @property
    def reduced(self) -> float:
        """χ² per degree of freedom."""
        return self.chi2 / self.dof if self.dof > 0 else math.nan

    @property
    def worst(self) -> float:
        """The smaller of p and of the smallest p of structure times the number of these tests (Bonferroni).

        Below `LIMIT` the model misses the data; a right one is told so in two cases of a thousand at most.
        """
        patterns = [s.p for s in self.structure if math.isfinite(s.p)]
        chances = [min(1.0, len(patterns) * min(patterns))] if patterns else []
        return min([*chances, *([self.p] if self.known else [])], default=math.nan)

    @property
    def told(self) -> bool:
        """Whether the model misses the data by more than chance."""
        return self.worst < LIMIT

    @property
    def adequate(self) -> bool | None:
        """Whether the data are described to the noise; None where nothing can be said."""
        return None if not math.isfinite(self.worst) else not self.told

    @property
    def overstated(self) -> bool:
        """Whether the residuals are smaller than the stated noise allows: errors stated too large, or shared by all."""
        return self.known and self.dof > 0 and _too_small(self.chi2, self.dof)

    @property
    def scale(self) -> float:
        """What errors that came from the noise grow by at least (Birge 1932): `ratio` where the model misses, or 1."""
        return max(1.0, self.ratio) if self.told and self.known else 1.0

    @property
    def words(self) -> str:
        """One sentence for the reader."""
        return _in_words(self)

    def to_dict(self) -> dict[str, object]:
        """For JSON: numbers that are not finite become None."""

        def number(x: float) -> float | None:
            return float(x) if math.isfinite(x) else None

        return {
            "chi2": number(self.chi2),
            "degrees_of_freedom": number(self.dof),
            "reduced": number(self.reduced),
            "p": number(self.p),
            "residual_over_noise": number(self.ratio),
            "noise": self.noise,
            "where": self.where,
            "where_over_noise": number(self.where_ratio),
            "relative_residual": number(self.relative),
            "structure": [
                {"by": s.name, "p": number(s.p), "where": s.where, "ratio": number(s.ratio), "groups": s.groups}
                for s in self.structure
            ],
            "worst_p": number(self.worst),
            "adequate": self.adequate,
            "words": self.words,
        }


def misfit(
    z: ArrayLike,
    jacobian: ArrayLike | None = None,
    *,
    groups: Sequence[Grouping] = (),
    series: Sequence[ArrayLike] = (),
    noise: str = "stated",
    known: bool = True,
    noise_dof: ArrayLike = math.inf,
    effective: float | None = None,
    relative: float = math.nan,
) -> Misfit:
    """Hold residuals against their noise, and against what they may hang on.

    Parameters
    ----------
    z
        (n,) residuals over their standard deviations (whitened, if their covariance is known).
    jacobian
        (k, n) derivatives of z by the fitted parameters at any scale, those at a bound left out. z loses its part along
        them, so that a fit by another loss than Σ z² is judged alike.
    groups
        What residuals are grouped by; groups without residuals do no harm.
    series
        (m,) numbers of residuals in their order, one array a series: signs that change too seldom are told.
    noise, known
        Where the standard deviations are from, in words, and whether they are known; if not, χ² says nothing, and the
        structure alone is judged.
    noise_dof
        A number: degrees of freedom of one standard deviation that all share, estimated from repeats (F for χ²).
        (n,) numbers: each residual has its own; its t is turned into the normal deviate of the same chance.
    effective
        How many independent residuals n correlated ones are worth (`effective_number`), n if not given. All p are
        then those of so many, approximately.
    relative
        Residual over signal, to be shown beside.

    Raises
    ------
    InputError
        Shapes that do not agree, residuals that are not finite, no more residuals than parameters, `effective`
        beyond n.
    """
    r = np.asarray(z, dtype=np.float64).ravel()
    rows = np.zeros((0, r.size)) if jacobian is None else np.atleast_2d(np.asarray(jacobian, dtype=np.float64))
    _check(r, rows, groups, effective)
    q = _orthonormal(rows)
    r = r - (q @ r) @ q
    share = 1.0 if effective is None else effective / r.size
    pooled = float(np.asarray(noise_dof)) if np.ndim(noise_dof) == 0 else math.inf
    left = 1.0 - np.einsum("kn,kn->n", q, q)  # variance that each residual keeps
    if np.ndim(noise_dof) > 0:
        r = _normal_deviates(r, left, np.asarray(noise_dof, dtype=np.float64))
    dof, chi2 = float(r.size - len(q)), float(np.einsum("n,n->", r, r))
    size = math.sqrt(chi2 / dof)
    unit = 1.0 if known else max(size, 1e-300)
    # What lies far below the noise is no matter, patterned or not: errors of rounding and quadrature.
    least = 1.0 if known and _too_small(chi2, dof) else 0.0
    found = [by_groups(g, r, q, left, share, unit, least) for g in groups]
    told = [s for s, _ in found if math.isfinite(s.p)]
    if series:
        told.append(Structure("runs", runs_p([np.asarray(r[np.asarray(index)]) for index in series])))
    weights = [0.5 if g.fine else 1.0 for g in groups]
    peaks = [(w * peak[1], peak) for w, (_, peak) in zip(weights, found, strict=True) if math.isfinite(peak[1])]
    where, where_ratio = max(peaks, key=lambda one: one[0])[1] if peaks else ("", math.nan)
    return Misfit(
        chi2=chi2,
        dof=dof,
        p=_chance(chi2 * share, dof * share, pooled) if known else math.nan,
        ratio=size if known else math.nan,
        noise=noise,
        structure=tuple(told),
        where=where,
        where_ratio=where_ratio,
        relative=relative,
    )


def _check(r: FloatArray, rows: FloatArray, groups: Sequence[Grouping], effective: float | None) -> None:
    if rows.shape[1:] != r.shape:
        raise InputError.of("jacobian", rows.shape, f"must be (parameters, {r.size})", "Give a row a parameter.")
    for g in groups:
        if g.index.shape != r.shape:
            raise InputError.of("groups", f"{g.name}: {g.index.shape}", f"must have {r.size} labels", "Give one each.")
    if not np.all(np.isfinite(r)) or not np.all(np.isfinite(rows)):
        raise InputError.of("z", "not finite", "must be numbers, as must the Jacobian", "Leave out what was not seen.")
    if r.size <= len(rows):
        raise InputError.of("z", r.size, f"must be more than the {len(rows)} parameters", "Fix some parameters.")
    if effective is not None and not len(rows) < effective <= r.size:
        raise InputError.of("effective", effective, f"must lie in ({len(rows)}, {r.size}]", "Leave it out if unknown.")


def _orthonormal(rows: FloatArray) -> FloatArray:
    """Orthonormal rows (rank, n) that span the given ones."""
    length = np.sqrt(np.einsum("kn,kn->k", rows, rows))
    rows = rows[length > 0] / length[length > 0, None]
    if not len(rows):
        return rows
    eigen, vectors = np.linalg.eigh(np.einsum("an,bn->ab", rows, rows))
    good = eigen > LOST * eigen[-1]
    return np.asarray((vectors[:, good] / np.sqrt(eigen[good])).T @ rows)


def _normal_deviates(r: FloatArray, left: FloatArray, dof: FloatArray) -> FloatArray:
    """Residuals over estimated standard deviations, Student's t, as the normal numbers that are as unlikely."""
    from scipy.special import ndtri, stdtr

    kept = np.sqrt(np.maximum(left, 1e-12))
    tail = np.maximum(stdtr(dof, -np.abs(r) / kept), 1e-300)
    return np.asarray(-np.sign(r) * ndtri(tail) * kept)


def _too_small(chi2: float, dof: float) -> bool:
    from scipy.special import gammainc

    return float(gammainc(0.5 * dof, 0.5 * chi2)) < LIMIT


def _chance(chi2: float, dof: float, noise_dof: float) -> float:
    from scipy.special import fdtrc, gammaincc

    if math.isinf(noise_dof):
        return float(gammaincc(0.5 * dof, 0.5 * chi2))
    return float(fdtrc(dof, noise_dof, chi2 / dof))


def times(ratio: float) -> str:
    """A ratio as a factor: 9, 1.04, .37.

    >>> times(9.123), times(1.0432), times(5837.0)
    ('9.1', '1.04', '5840')
    """
    return f"{float(f'{ratio:.3g}'):.0f}" if ratio >= 100 else f"{ratio:.3g}" if ratio < 2 else f"{ratio:.2g}"


def chance(p: float) -> str:
    """A p value.

    >>> chance(0.1934), chance(2.345e-5), chance(0.0)
    ('p .19', 'p 2e-05', 'p < 1e-16')
    """
    if p < 1e-16:
        return "p < 1e-16"
    if p < 1e-3:
        return f"p {p:.0e}"
    return "p " + (f"{p:.2f}" if p >= 0.1 else f"{p:.2g}").removeprefix("0")


def _in_words(m: Misfit) -> str:
    """One sentence: by how much the model misses its data, where, and what that means for the intervals."""
    size = f"residual {100 * m.relative:.2g} %, " if math.isfinite(m.relative) else "residual "
    figures = f"chi2 {m.chi2:.4g} for {m.dof:.6g} degrees of freedom, {chance(m.p)}" if m.known else ""
    over = f"{size}{times(m.ratio)} x the noise ({figures})" if m.known else ""
    pattern = min((s for s in m.structure if math.isfinite(s.p)), key=lambda s: s.p, default=None)
    by = "" if pattern is None else "their order" if pattern.name == "runs" else pattern.name
    if not m.known and not m.told:
        rest = "" if m.adequate is None else "; its residuals show no pattern"
        return f"the noise is not known ({m.noise}): whether the model fits cannot be told{rest}"
    if not m.told:
        more = ""
        if m.overstated and m.ratio < 0.9:
            more = f"; the noise ({m.noise}) is {times(1 / max(m.ratio, 1e-9))} x larger than what scatters"
        return f"the model fits to the noise: {over}{more}"
    if m.known and m.p < LIMIT:
        at = f" {m.where}" if m.where and m.where_ratio > m.ratio else ""
        factor = times(m.where_ratio if at else m.ratio)
        return f"the model misses the data by {factor} x the noise{at}; {over}; {CAVEAT}"
    most = f", most {pattern.where}" if pattern is not None and pattern.where else ""
    head = f"the model misses the data: its residuals are not random but hang on {by}"
    told = "" if pattern is None else f" ({chance(pattern.p)}{most})"
    return f"{head}{told}; {over or f'the noise is not known ({m.noise})'}; {CAVEAT}"
