"""What the report of a fit shows between its claims and its provenance."""

from __future__ import annotations

import pandas as pd

from livlab.kinds.fit import report_figures as draw
from livlab.kinds.fit.report_round_trip import round_trip_section
from livlab.reports.bench import bench_section
from livlab.reports.figures import Pictures
from livlab.reports.folder import RunData
from livlab.reports.tables import ReportSection, Table, Text, from_frame, number

_HEADINGS = {
    "sd": "standard deviation",
    "sd_note": "why not shown",
    "drift": "moved by fresh draws",
    "lower": "from",
    "upper": "to",
}

_SHOWN = ["parameter", "unit", "value", "lower", "upper", "open", "sd", "sd_note", "drift", "status", "start"]


SPREAD_CAPTION = (
    "What other models say beside each interval: the interval of the fit alone, the mean weighed by how well each "
    "model explains the data, the interval of that mixture, and the least and largest value of all models."
)
_SPREAD_HEADINGS = {
    "own": "its interval",
    "weighted": "over the models, weighted",
    "whole": "interval over the models",
    "values": "values, least to most",
}
_MODELS = (
    "alternative", "loss", "chi2_per_dof", "p", "numbers", "parameters", "aic", "bic", "weight_aic", "weight_bic",
    "settled", "lacks", "error",
)  # fmt: skip
_MODEL_HEADINGS = {
    "alternative": "model", "chi2_per_dof": "χ² per degree of freedom", "aic": "AIC", "bic": "BIC",
    "weight_aic": "weight by AIC", "weight_bic": "weight by BIC", "numbers": "numbers compared",
}  # fmt: skip


def fit_sections(run: RunData, pictures: Pictures) -> list[ReportSection]:
    """Sections of a run of kind "fit"."""
    if run.result is None or not len(run.table("fit")):
        return []
    result, found = run.result, run.table("fit")
    curves = ReportSection("curves", "The curves, and what the fit makes of them")
    curves.content.extend(_misfit(run))
    curves.content.extend(
        [
        pictures.add(
                "fit-curves",
                draw.curves(result),
                "Measured and fitted curves as they were compared; shaded: ±2σ of the measurement.",
            ),
        from_frame(
            run.table("scores").dropna(axis="columns", how="all"),
            "RMSE and Pearson's correlation of the compared curves, fitted and at the start.",
            titles={"first_nm": "first [nm]", "last_nm": "last [nm]", "rmse": "RMSE", "pearson": "Pearson",
                    "rmse_start": "RMSE at the start", "pearson_start": "Pearson at the start"},
        ),
        ]
    )  # fmt: skip
    values = _parameters(run, pictures, found)
    search = ReportSection("search", "The search, and its price")
    search.content.extend(
        [
            pictures.add(
                "fit-path", draw.path(run.table("path")), "Loss of each trial (dots) and the best so far (line)."
            ),
            from_frame(
                run.table("costs"),
                "What each stage took.",
                only=["stage", "seconds", "evaluations", "samples", "error"],
                titles={"error": "standard error of the total reflectance"},
            ),
            from_frame(run.table("recordings"), "The recorded walks.", folded="Recordings"),
        ]
    )
    return [curves, *bench_section(run), values, *_alternatives(run), round_trip_section(run, pictures), search]


def _beside(spread: pd.DataFrame) -> pd.DataFrame:
    """Each parameter's own interval, and beside it what the models together say."""

    def ends(low: float, high: float) -> str:
        return f"{number(low, 3)} to {number(high, 3)}" if pd.notna(low) and pd.notna(high) else "–"

    return pd.DataFrame(
        {
            "parameter": spread["parameter"],
            "unit": ["" if pd.isna(u) else str(u) for u in spread["unit"]],
            "own": [ends(a, b) for a, b in zip(spread["lower"], spread["upper"], strict=True)],
            "weighted": spread["weighted"],
            "whole": [ends(a, b) for a, b in zip(spread["weighted_lower"], spread["weighted_upper"], strict=True)],
            "values": [ends(a, b) for a, b in zip(spread["least"], spread["most"], strict=True)],
            "models": spread["models"],
        }
    )


def _alternatives(run: RunData) -> list[ReportSection]:
    """The other models: how well each explains the data, and what each says."""
    models, each = run.table("alternatives"), run.table("alternative_values")
    if not len(models):
        return []
    section = ReportSection("alternatives", "Other models of the same data")
    shown = models.dropna(axis="columns", how="all")
    section.content.extend(
        [
            from_frame(
                shown,
                "Each model fitted to the same curves. The weight is exp(−Δ/2) of its criterion (Akaike 1974; Schwarz "
                "1978) over the sum; it compares these models only, and says of none that it is right.",
                only=[c for c in _MODELS if c in shown],
                titles=_MODEL_HEADINGS,
            ),
            from_frame(
                each,
                "What each model says.",
                only=["parameter", "alternative", "value", "lower", "upper", "unit", "status", "weight"],
                titles=_HEADINGS,
                folded="Values by model",
            ),
        ]
    )
    return [section]


def _parameters(run: RunData, pictures: Pictures, found: pd.DataFrame) -> ReportSection:
    """What was found, with intervals."""
    assert run.result is not None
    level = float(run.result.attrs["level"])
    values = ReportSection("parameters", "The tissue that fits")
    values.content.extend(
        [
            Text(_verdict(run, found)),
            from_frame(
                _shown(found),
                f"Fitted values with {level:.0%} profile-likelihood intervals. An open end is a bound that the data "
                "do not exclude. No standard deviation is shown where it says something else than the interval: at a "
                "bound, where it takes another value that sits at its bound as known (conditional), or where the "
                "interval is skew.",
                titles=_HEADINGS,
                only=_SHOWN,
            ),
            pictures.add("fit-intervals", draw.intervals(found, level), "Values and intervals between their bounds."),
        ]
    )
    if len(run.table("correlation")) > 1:
        values.content.append(
            pictures.add("fit-correlation", draw.correlation(run.table("correlation")), "Correlation at the optimum.")
        )
    if len(run.table("spread")):
        values.content.append(from_frame(_beside(run.table("spread")), SPREAD_CAPTION, titles=_SPREAD_HEADINGS))
    return values


def _misfit(run: RunData) -> list[Text | Table]:
    """Whether the model describes the data, first of all; nothing for runs that did not ask."""
    assert run.result is not None
    said = str(run.result.attrs.get("misfit", ""))
    if not said:
        return []
    table = from_frame(
        run.table("misfit").dropna(axis="columns", how="all"),
        "Residuals held against their noise, and against what they may hang on: p is the chance that a right model "
        "looks so. Ratio: residual over noise, as a whole, and where it is largest.",
        titles={"degrees_of_freedom": "degrees of freedom", "chi2": "χ²"},
    )
    return [Text(f"{said[:1].upper()}{said[1:]}."), table]


def _shown(found: pd.DataFrame) -> pd.DataFrame:
    """The table of parameters without changes that are rounding, and without an sd that says something else."""
    made = found.assign(drift=found["drift"].where(found["drift"].abs() > 1e-9 * found["value"].abs(), 0.0))
    if "sd_note" not in made:
        return made.assign(sd_note="")
    note = made["sd_note"].fillna("").astype(str)
    return made.assign(sd_note=note, sd=made["sd"].where(note == ""))


def _verdict(run: RunData, found: pd.DataFrame) -> str:
    assert run.result is not None
    a = run.result.attrs
    held = found[found["status"] == "free"]["parameter"].tolist()
    bound = found[found["status"].str.contains("bound")]["parameter"].tolist()
    told = [
        f"{int(a['evaluations'])} evaluations found a loss of {number(float(a['loss']), 3)}"
        + (", which fresh draws confirmed." if int(a["settled"]) else ", which fresh draws did not confirm.")
    ]
    if bound:
        told.append(f"At a bound: {_and(bound)}; the optimum may lie beyond it.")
    free = found[found["open"].astype(str) == "both"]["parameter"].tolist()
    if free:
        told.append(f"Not identifiable: {_and(free)}, whose interval reaches from bound to bound.")
    if a["verdict"] != "held" and held:
        condition = number(float(a["condition"]), 2)
        told.append(
            f"As a whole the data hold {_and(held)} only {'weakly' if a['verdict'] == 'weak' else 'in part'} "
            f"(condition number {condition}): see the notes for the combination that they leave open."
        )
    if abs(float(a["autocorrelation"])) > 0.3:
        told.append(
            f"Neighbouring residuals are alike (correlation {number(float(a['autocorrelation']), 2)}): what is left is "
            "the model's own misfit, and the intervals count fewer points for it."
        )
    return " ".join(told)


def _and(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
