"""Figures and sentences about what accuracy cost: of one run, and of every solver on its scene (`livlab cost`)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pandas as pd
from matplotlib.figure import Figure

from livlab.reports.figures import INK, MARKERS, MUTED, colour, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NEXT_DIGIT = 100.0
"""What a tenth of a Monte Carlo error costs, in times of what was spent."""

_PLACE = {
    name: k
    for k, name in enumerate(
        ("walk expected", "adding-doubling", "walk analog", "kubelka-munk", "diffusion", "ledger", "other")
    )
}
_BIASED = ("kubelka-munk", "diffusion")


def cost_figure(cost: pd.DataFrame) -> Figure:
    """Error against time of every solver, from the rows of cost.csv: both logarithmic, with the Pareto front.

    A solver that is off by a bias stays where it is however long it works: a dotted line says so. The dashed lines
    fall with slope −1/2, as a Monte Carlo error does, on to its next digit.
    """
    cost = cost.assign(shown=shown_error(cost))
    cost = cost[(cost["shown"] > 0) & (cost["seconds"] > 0)]
    own = float(cost["reference_error"].iloc[0])
    with style():
        figure = Figure(figsize=(7.4, 5.0))
        ax = figure.subplots()
        ax.set_xscale("log")
        ax.set_yscale("log")
        end = 3.0 * max(float(cost["seconds"].max()), *(_next(rows)[0] for _, rows in _walks(cost)), 0.0)
        for name, rows in cost.groupby("solver", sort=False):
            _solver(ax, str(name), rows.sort_values("seconds"), end)
        front = cost[_true(cost["pareto"])].sort_values("seconds")
        # Luck in sampling makes no front.
        said = front["stated"].where(front["samples"] > 0, 0.0)
        y = [float(e) for e in front["shown"].combine(said, max)]
        x, y = [*front["seconds"], end], [*y, y[-1]]
        ax.step(x, y, where="post", color=MUTED, lw=6, alpha=0.22, zorder=1, label="Pareto front")
        if _walks(cost):
            t, e = _next(dict(_walks(cost))[_best_walk(cost)])
            ax.annotate(
                f"next digit: {duration(t)}", (t, e), xytext=(-4, -4), textcoords="offset points", ha="right", va="top",
                fontsize=8.5, color=MUTED,
            )  # fmt: skip
        ax.axhline(own, color=INK, lw=1, ls=(0, (1, 2)), zorder=1)
        ax.annotate(
            f"error of the reference ({cost['reference'].iloc[0]})", (0.995, own), xycoords=("axes fraction", "data"),
            ha="right", va="bottom", fontsize=8.5, color=MUTED,
        )  # fmt: skip
        ax.set_xlim(right=end)
        ax.set_xlabel("time for all wavelengths [s], compiling apart")
        ax.set_ylabel("error (root mean square over the wavelengths)")
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
        return figure


def run_figure(costs: pd.DataFrame, convergence: pd.DataFrame) -> Figure:
    """How the error of each reading fell while it was sampled, and on to its next digit with slope −1/2.

    Parameters
    ----------
    costs
        Rows of costs.csv: those with an error but no samples (a deterministic solver) are points.
    convergence
        Rows of convergence.csv.
    """
    with style():
        figure = Figure(figsize=(7.4, 3.8))
        ax = figure.subplots()
        ax.set_xscale("log")
        ax.set_yscale("log")
        done = costs[costs["stage"] == "measure"]
        for k, (reading, solver, error, seconds) in enumerate(
            zip(done["reading"], done["solver"], done["error"], done["seconds"], strict=True)
        ):
            rows = convergence[convergence["reading"] == reading] if len(convergence) else convergence
            x, y = (rows["seconds"], rows["error"]) if len(rows) else ([seconds], [error])
            ax.plot(x, y, color=colour(k), marker=MARKERS[k % len(MARKERS)], label=f"{reading} ({solver})")
            if len(rows):
                t, e = float(rows["seconds"].iloc[-1]), float(rows["error"].iloc[-1])
                ax.plot([t, NEXT_DIGIT * t], [e, e / 10], color=colour(k), lw=1.2, ls=(0, (4, 3)))
        ax.set_xlabel("time for all wavelengths [s]")
        ax.set_ylabel("error (root mean square)")
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
        return figure


def shown_error(cost: pd.DataFrame) -> pd.Series[float]:
    """The error as measured; where the reference is too close to measure it, as the solver states it."""
    return cost["error"].where(_true(cost["trusted"]), cost["stated"])


def sentence(cost: pd.DataFrame) -> str:
    """What the next digit costs on this scene, from the rows of cost.csv.

    >>> row = dict(solver="walk expected", samples=10**6, seconds=4.8, error=0.0011, stated=0.0012, valid=True)
    >>> row |= dict(trusted=True, reference="walk expected", reference_error=1e-5)
    >>> sentence(pd.DataFrame([row]))
    'walk expected: an error of 0.0012 in 4.8 s; the next digit costs 100×: 8 min.'
    """
    parts = []
    for name, rows in _walks(cost):
        if name != _best_walk(cost):
            continue
        last = rows.sort_values("samples").iloc[-1]
        seconds = float(last["seconds"])
        parts.append(
            f"{name}: an error of {float(last['stated']):.2g} in {_seconds(seconds)}; the next digit costs 100×: "
            f"{duration(NEXT_DIGIT * seconds)}"
        )
    exact = cost[(cost["solver"] == "adding-doubling") & _true(cost["valid"])]
    if len(exact):
        finest = exact.sort_values("stated").iloc[0]
        parts.append(
            f"adding-doubling: {float(finest['stated']):.1g} in {_seconds(float(finest['seconds']))}, without noise"
        )
    biased = cost[cost["solver"].isin(_BIASED) | (~_true(cost["valid"]) & (cost["solver"] != "ledger"))]
    for solver, rows in biased.groupby("solver", sort=False):
        parts.append(f"{solver} is off by {float(rows['error'].iloc[-1]):.1g} here however long it works")
    return "; ".join(parts) + "."


def run_rows(costs: pd.DataFrame) -> pd.DataFrame:
    """What each reading's accuracy cost, and what its next digit would."""
    done = costs[costs["stage"] == "measure"]
    noisy = done["samples"].fillna(0) > 0
    return pd.DataFrame(
        {
            "reading": done["reading"],
            "solver": done["solver"],
            "samples": done["samples"],
            "time": [_seconds(float(x)) for x in done["seconds"]],
            "largest error": [f"{float(x):.2g}" for x in done["error"]],
            "of the maximum": [f"{100 * float(x):.2g} %" for x in done["relative_error"]],
            "next digit": [
                duration(NEXT_DIGIT * float(x)) if random else "no noise to lower"
                for x, random in zip(done["seconds"], noisy, strict=True)
            ],
        }
    )


def duration(seconds: float) -> str:
    """Time in a unit that suits it.

    >>> duration(8.0), duration(480.0), duration(7200.0), duration(4e5)
    ('8 s', '8 min', '2.0 h', '4.6 days')
    """
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h" if seconds < 172800 else f"{seconds / 86400:.1f} days"


def _solver(ax: Axes, name: str, rows: pd.DataFrame, end: float) -> None:
    k = _PLACE.get(name, len(_PLACE) - 1)
    x, y = rows["seconds"].to_numpy(), rows["shown"].to_numpy()
    trusted, valid = _true(rows["trusted"]).to_numpy(), bool(_true(rows["valid"]).all())
    paint: dict[str, Any] = {"color": colour(k), "marker": MARKERS[k], "zorder": 3}
    label = name if valid else f"{name} (outside its domain)"
    ax.plot(x[trusted], y[trusted], ls="none", label=label if trusted.any() else None, **paint)
    # Hollow: the reference is too close to tell, so it is what the solver says of itself.
    hollow = None if trusted.any() else f"{label}, as it states"
    ax.plot(x[~trusted], y[~trusted], ls="none", mfc="none", label=hollow, **paint)
    if name in _BIASED or (not valid and name != "ledger"):
        ax.plot([x[-1], end], [y[-1], y[-1]], color=colour(k), lw=1.2, ls=(0, (1, 2)), zorder=2)
    elif name.startswith("walk") or name == "ledger":
        t, e = _next(rows)
        if t > 0:
            start = float(x.min())
            fall = [e * math.sqrt(t / start), e]
            ax.plot([start, t], fall, color=colour(k), lw=1.2, ls=(0, (4, 3)), zorder=2, label=f"{name}: slope −1/2")


def _next(rows: pd.DataFrame) -> tuple[float, float]:
    """Time and error of a walk's next digit, from its largest sample count."""
    last = rows.sort_values("samples").iloc[-1]
    return NEXT_DIGIT * float(last["seconds"]), float(last["stated"]) / 10.0


def _walks(cost: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    groups = cost.groupby("solver", sort=False)
    noisy = [(str(name), rows) for name, rows in groups if str(name).startswith("walk") or name == "ledger"]
    return [(name, rows) for name, rows in noisy if rows["stated"].notna().all()]


def _best_walk(cost: pd.DataFrame) -> str:
    """The walk (recorded or not) whose error times the root of its time is least."""
    return min(_walks(cost), key=lambda x: _merit(x[1]))[0]


def _merit(rows: pd.DataFrame) -> float:
    last = rows.sort_values("samples").iloc[-1]
    return float(last["stated"]) * math.sqrt(float(last["seconds"]))


def _seconds(seconds: float) -> str:
    return f"{seconds:.2g} s" if seconds < 90 else duration(seconds)


def _true(column: pd.Series[Any]) -> pd.Series[bool]:
    return column.astype(str).str.lower().isin(["true", "1"])
