"""What the report of a study shows between its claims and its provenance."""

from __future__ import annotations

import numpy as np
import pandas as pd

from livlab.kinds.study import report_figures as draw
from livlab.reports.figures import Pictures
from livlab.reports.folder import RunData
from livlab.reports.tables import ReportSection, Text, from_frame, number, with_error

MOST_ROWS = 200
"""Rows of a table on the page; the whole stands in results.csv."""

MOST_SCATTER = 12
"""Factors beyond which a scatter has no room."""


def study_sections(run: RunData, pictures: Pictures) -> list[ReportSection]:
    """Sections of a run of kind "study"."""
    if run.result is None or not len(run.table("results")):
        return []
    method = str(run.result.attrs["method"])
    if method == "ablation":
        return _ablation(run, pictures)
    return [*(_sensitivity(run, pictures) if method == "sensitivity" else []), *_points(run, pictures)]


def _points(run: RunData, pictures: Pictures) -> list[ReportSection]:
    assert run.result is not None
    factors = run.table("factors")
    logarithmic = [str(t) == "log" for t in factors["transform"]]
    section = ReportSection("points", "The points")
    section.content.append(_varied(factors))
    section.content.extend(Text(str(t)) for t in factors.get("told", pd.Series(dtype=str)).dropna())
    for k in _telling(run.table("indices"), factors):
        name = str(factors["factor"].iloc[k])
        caption = f"Curves of all points, coloured by {name}."
        section.content.append(pictures.add(f"curves-{k}", draw.curves(run.result, k, logarithmic[k]), caption))
    outputs = [str(run.result[f"output_{k}"].attrs["long_name"]) for k in range(_count(run, "output"))]
    if len(factors) == 2 and _is_grid(run.table("results"), factors):
        for k, name in enumerate(outputs):
            if np.isfinite(run.result[f"output_{k}"]).any():
                figure = draw.heat(run.result, k)
                section.content.append(pictures.add(f"heat-{k}", figure, f"Over both factors: {name}."))
    elif len(factors) <= MOST_SCATTER:
        against = "every factor" if len(factors) > 1 else str(factors["factor"].iloc[0])
        for k, name in enumerate(outputs):
            if np.isfinite(run.result[f"output_{k}"]).any():
                figure = draw.scatter(run.result, k, logarithmic)
                section.content.append(pictures.add(f"scatter-{k}", figure, f"Against {against}: {name}."))
    table = run.table("results")
    section.content.append(Text(_extremes(table, outputs, factors)))
    more = f" (the first {MOST_ROWS} of {len(table)}; all in results.csv)" if len(table) > MOST_ROWS else ""
    shown = table.head(MOST_ROWS).drop(columns=[c for c in ("error",) if not table[c].notna().any()])
    section.content.append(from_frame(shown, f"Every point{more}.", folded="The numbers"))
    return [section]


def _telling(found: pd.DataFrame, factors: pd.DataFrame) -> list[int]:
    """Numbers of the factors to colour curves by: those that decide most where that is known, else the first."""
    names = [str(f) for f in factors["factor"]]
    if not len(found):
        return list(range(min(3, len(names))))
    column = "total" if "total" in found else "mu_star"
    most = found.groupby("factor")[column].max().sort_values(ascending=False)
    return [names.index(str(n)) for n in most.index[:2]]


def _varied(factors: pd.DataFrame) -> object:
    shown = factors.assign(
        range=[
            str(v)
            if pd.notna(v) and str(v)
            else f"{number(low)} to {number(high)}{', by logarithm' if t == 'log' else ''}"
            for v, low, high, t in zip(
                factors["values"], factors["low"], factors["high"], factors["transform"], strict=True
            )
        ],
        unit=["" if pd.isna(u) else str(u) for u in factors["unit"]],
    )
    if "moves" not in shown or not shown["moves"].notna().any():  # a run made before it was told
        return from_frame(shown, "What varies.", only=["factor", "range", "unit", "path"])
    caption = "What varies, and whether it moves any output by more than its error, or than a thousandth of its level."
    return from_frame(shown, caption, only=["factor", "range", "unit", "path", "moves"])


def _sensitivity(run: RunData, pictures: Pictures) -> list[ReportSection]:
    found, settling = run.table("indices"), run.table("settling")
    section = ReportSection("indices", "What decides the outputs")
    undefined = settling[settling["verdict"] == "undefined"] if len(settling) else settling
    if len(found):
        sobol = "total" in found
        section.content.append(Text(_leaders(found, sobol)))
        caption = (
            "Sobol indices: the share of each output's variance that a factor decides alone (first), and with all it "
            "does together with others (total). Bars: intervals by bootstrap."
            if sobol
            else "Morris's elementary effects over a factor's whole range: their mean size μ*, and their spread σ, "
            "which is large where a factor acts otherwise in other places."
        )
        section.content.append(pictures.add("indices", draw.indices(found), caption))
        last = found[found["points"] == found["points"].max()]
        section.content.append(from_frame(_with_intervals(last, sobol), "The same in numbers.", folded="The numbers"))
    for row in undefined.to_dict("records"):
        section.content.append(Text(f"The indices of {row['output']} are undefined: {row['reason']}"))
    told = ReportSection("settling", "Whether the indices have settled")
    defined = settling[settling["verdict"] != "undefined"] if len(settling) else settling
    if len(defined):
        told.content.append(Text(_settled(defined)))
        told.content.append(
            pictures.add(
                "settling", draw.settling(found), "Indices from a part of the same design, with their intervals."
            )
        )
        told.content.append(
            from_frame(
                defined,
                "Half-width of the widest interval, and the largest change from half of the base points to all.",
                only=["output", "points", "widest_interval", "change_from_half", "wanted", "sum_of_first", "verdict"],
            )
        )
    return [section, told]


def _leaders(found: pd.DataFrame, sobol: bool) -> str:
    column = "total" if sobol else "mu_star"
    last = found[found["points"] == found["points"].max()]
    told = []
    for output, part in last.groupby("output", sort=False):
        best = part.sort_values(column, ascending=False).head(3)
        named = [f"{r['factor']} ({number(r[column], 2)})" for r in best.to_dict("records")]
        told.append(f"{_capital(str(output))}: {', '.join(named)}.")
    what = "total index" if sobol else "mean size of the effect"
    return f"Most by {what}. {' '.join(told)}"


def _with_intervals(last: pd.DataFrame, sobol: bool) -> pd.DataFrame:
    made = last[["output", "factor"]].copy()
    for column in ("first", "total") if sobol else ("mu_star",):
        made[column] = [f"{v:.3f} ± {h:.3f}" for v, h in zip(last[column], last[f"{column}_interval"], strict=True)]
    if not sobol:
        made["mu"], made["sigma"] = last["mu"], last["sigma"]
    return made


def _settled(defined: pd.DataFrame) -> str:
    bad = defined[defined["verdict"] != "converged"]["output"].tolist()
    wanted = number(float(defined["wanted"].iloc[0]))
    head = f"With {number(int(defined['points'].iloc[0]))} base points "
    if not bad:
        return f"{head}no interval is wider than ±{wanted}, and doubling the points moved no index by more than that."
    return (
        f"{head}the indices of {_and(bad)} have not settled to ±{wanted}: read their order, not their digits, or take "
        "more points."
    )


def _ablation(run: RunData, pictures: Pictures) -> list[ReportSection]:
    assert run.result is not None
    table, targets = run.table("ablation"), run.table("targets")
    outputs = [str(run.result[f"output_{k}"].attrs["long_name"]) for k in range(_count(run, "output"))]
    every = outputs
    if len(targets):  # the others stand in ablation.csv
        outputs = [o for o in outputs if o in set(targets["output"])]
    sections = []
    if len(targets):
        verdict = ReportSection("verdict", "What explains the figures")
        verdict.content.extend(Text(text) for text in verdict_sentences(table, targets))
        verdict.content.append(
            from_frame(targets, "What is to be explained.", only=["output", "value", "tolerance", "source"])
        )
        near = table[table["worst off"].notna() & table["same_as"].isna()].sort_values("worst off").head(12)
        verdict.content.append(
            from_frame(
                _shown(near, every).assign(**{"worst off": near["worst off"]}),
                "The nearest cases; off: the worst distance from a figure, in tolerances.",
                titles={"worst off": "off"},
            )
        )
        sections.append(verdict)
    changes = ReportSection("changes", "What each change does")
    metrics = {str(d.attrs["long_name"]): str(d.attrs["metric"]) for k, d in run.result.items() if "metric" in d.attrs}
    figure = draw.cases(table, outputs, targets, metrics)
    shaded = " Shaded: what is to be explained." if len(targets) else ""
    changes.content.append(pictures.add("cases", figure, f"Every case that differs, ±2 standard errors.{shaded}"))
    captions = {
        "option": "Options of the readings, each changed alone. A change of 0 is exact: the scene is the same. "
        "Shaded: a change of more than three standard errors, and of a thousandth of the output's level.",
        "path": "All the way, an option at a time; each change is against the line before.",
        "effect": "Effects left out, each alone.",
    }
    changes.content.append(from_frame(_shown(table[table["group"] == "base"], every), "The readings as they stand."))
    for group, caption in captions.items():
        for base, part in table[table["group"] == group].groupby("base" if group == "option" else "group", sort=False):
            tail = f" Base: {base}." if group == "option" else ""
            changes.content.append(
                from_frame(_changed(part, outputs), caption + tail, titles={"choice": "to"}, marked="moves")
            )
    return [*sections, changes]


def _shown(part: pd.DataFrame, outputs: list[str]) -> pd.DataFrame:
    made = pd.DataFrame({"case": part["case"]})
    for o in outputs:
        made[o] = [with_error(v, e) for v, e in zip(part[o], part[f"{o} error"], strict=True)]
    return made.assign(seconds=part["seconds"].round(2))


def _changed(part: pd.DataFrame, outputs: list[str]) -> pd.DataFrame:
    made = pd.DataFrame()
    if part["row"].notna().any():
        made["row"] = [str(int(r)) if pd.notna(r) else "–" for r in part["row"]]
    made["option"], made["choice"] = part["option"].to_numpy(), part["choice"].to_numpy()
    if (part["group"] == "effect").all():
        made = made.drop(columns="choice").rename(columns={"option": "effect"})
    moves = np.zeros(len(part), dtype=bool)
    for o in outputs:
        made[o] = [number(v, 3) for v in part[o]]
        change, error = part[f"{o} change"].to_numpy(dtype=float), part[f"{o} change error"].to_numpy(dtype=float)
        made[f"its change{' ' * len(made.columns)}"] = [
            "0" if c == 0.0 and e == 0.0 else _signed(c, e) for c, e in zip(change, error, strict=True)
        ]
        moves |= np.abs(change) > 3 * error
    if "moves" in part:
        moves = (part["moves"] == "yes").to_numpy()
    made["seconds"] = [number(v, 3) if pd.notna(v) else "–" for v in part["seconds"]]
    made["moves"] = moves
    return made


def _signed(change: float, error: float) -> str:
    text = with_error(change, error)
    return f"+{text}" if change > 0 and text[:1].isdigit() else text.replace("-", "−", 1)


def verdict_sentences(table: pd.DataFrame, targets: pd.DataFrame) -> list[str]:
    """What the numbers say of the figures to be explained: which cases have them all, and what the bases lack."""
    own = table[table["same_as"].isna()]
    known = own[own["worst off"].notna()].sort_values("worst off")
    names = [str(t) for t in targets["output"]]
    if not len(known):
        return ["No case has a value for every figure, so that none explains them."]
    within = known[known["worst off"] <= 1.0]
    best = known.iloc[0]
    values = ", ".join(f"{n} {with_error(best[n], best[f'{n} error'])}" for n in names)
    told = []
    if len(within):
        cases = _and([f"“{c}”" for c in within["case"]])
        one = len(within) == 1
        told.append(
            f"{len(within)} of {len(known)} different cases {'has' if one else 'have'} every figure within its "
            f"tolerance: {cases}. Nearest is “{best['case']}”: {values}."
        )
    else:
        told.append(
            f"None of {len(known)} different cases has every figure within its tolerance. Nearest is “{best['case']}”, "
            f"{number(float(best['worst off']), 2)} tolerances off at worst: {values}."
        )
    for base in own[own["group"] == "base"].to_dict("records"):
        off = {n: float(base[f"{n} off"]) for n in names}
        missed = [
            f"{n} ({with_error(base[n], base[f'{n} error'])}, wanted {number(float(v))})"
            for n, v in zip(names, targets["value"], strict=True)
            if not off[n] <= 1.0
        ]
        told.append(f"The {base['case']} reading {'misses ' + _and(missed) if missed else 'has them all'}.")
    return told


def _extremes(table: pd.DataFrame, outputs: list[str], factors: pd.DataFrame) -> str:
    told = []
    for o in outputs:
        if o not in table or not table[o].notna().any():
            told.append(f"{_capital(o)}: no point has a value.")
            continue
        ends = []
        for word, k in (("least", table[o].idxmin()), ("largest", table[o].idxmax())):
            row = table.iloc[int(str(k))]
            where = ", ".join(
                f"{n} {number(row[c], 3)}" for n, c in zip(factors["factor"], factors["column"], strict=True)
            )
            ends.append(f"{word} {number(float(row[o]))}" + (f" at {where}" if len(factors) <= 3 else f" at point {k}"))
        told.append(f"{_capital(o)}: {'; '.join(ends)}.")
    return " ".join(told)


def _count(run: RunData, what: str) -> int:
    assert run.result is not None
    k = 0
    while f"{what}_{k}" in run.result:
        k += 1
    return k


def _is_grid(table: pd.DataFrame, factors: pd.DataFrame) -> bool:
    a, b = (table[str(c)] for c in factors["column"])
    return bool(a.nunique() * b.nunique() == len(table))


def _capital(text: str) -> str:
    """As a sentence begins; a symbol (a*, b*) stays one."""
    return text if text[1:2] == "*" else text[:1].upper() + text[1:]


def _and(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
