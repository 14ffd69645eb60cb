"""Words of a picture's report: captions, what a screen reader says, and where a reading fails and why."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from livlab.kinds.picture.report_figures import name_of, tissues
from livlab.reports.folder import RunData
from livlab.reports.tables import number, wanted_words

_LIGHTS = {
    "area": "a rectangle of {w:g} × {h:g} mm",
    "point": "a point",
    "spot": "a spot",
    "directional": "parallel light",
    "environment": "light from all around",
}
ROUTES = {
    "thesis": "the thesis's colour",
    "stochastic": "colour from random wavelengths",
    "cie": "colour of the CIE's observer",
}
_MODELS = {
    "lambert": "Lambert",
    "blinn-phong": "Blinn–Phong",
    "ashikhmin-shirley": "Ashikhmin–Shirley lobe plus Lambert",
    "dipole": "dipole of Jensen 2001",
}


def own_name(run: RunData) -> str:
    """How the run's own tissue is called beside others: its state; nothing where there are no others."""
    if not run.config.get("compared"):
        return ""
    state = run.config.get("tissue", {}).get("inline", {}).get("state", "")
    return str(state).replace("_", " ") or "own"


def last_layer(run: RunData) -> str:
    """What colour comes from, by its name: the last layer, if the pictures' tissues agree on it."""
    table = run.table("absorption")
    names = sorted(set(table["layer"].dropna().astype(str))) if "layer" in table else []
    return f"the {names[0]}" if len(names) == 1 else "the last layer"


def above(run: RunData) -> str:
    """What lies above the last layer, by its name if it is one layer."""
    table = run.table("tissue")
    names = list(dict.fromkeys(table["layer"].dropna().astype(str))) if "layer" in table else []
    return f"the {names[0]}" if len(names) == 2 and last_layer(run) == f"the {names[1]}" else "what lies"


def lights(run: RunData) -> str:
    """The lights in words: kinds, and levels."""
    told = []
    for light in run.config.get("light", []):
        w, h = light.get("size_mm", (0, 0))
        what = _LIGHTS.get(str(light.get("kind")), str(light.get("kind"))).format(w=w, h=h)
        told.append(f"{what} (level {number(float(light.get('level', 1.0)), 3)})")
    return "; ".join(told)


def light_words(run: RunData) -> str:
    """One paragraph: how the pictures were lit and exposed."""
    exposure = float(run.config.get("colour", {}).get("exposure", 1.0))
    text = (
        f"Light: {lights(run)}. A light of level 1 makes a perfect white diffuser that faces it just white at "
        f"exposure 1; the exposure here is {number(exposure, 3)}, the same for every picture on this page."
    )
    tissues = [str(c["name"]) for c in run.config.get("compared", [])]
    if tissues:
        text += f" Compared in the same scene: {', '.join(tissues)}."
    return text


def _cost(run: RunData, row: dict[str, Any]) -> dict[str, Any]:
    costs = run.table("costs")
    if not len(costs) or "reading" not in row or pd.isna(row.get("reading")):
        return {}
    tissue = row.get("tissue")
    same = (costs["stage"] == "picture") & (costs["reading"] == row["reading"])
    same &= costs["tissue"].isna() if pd.isna(tissue) else costs["tissue"] == tissue
    found = costs[same]
    return {str(k): v for k, v in found.iloc[0].items()} if len(found) else {}


def caption(run: RunData, row: dict[str, Any], *, lit_by: bool = False) -> str:
    """Reading, colour route, samples, seconds and error of a picture."""
    if isinstance(row.get("baseline"), str):
        return str(_MODELS.get(row["baseline"], row["baseline"]))
    text = f"{name_of(row, own_name(run))} reading; {ROUTES.get(str(row['route']), str(row['route']))}"
    if lit_by:
        text += f"; {lights(run)}"
    cost = _cost(run, row)
    if cost:
        text += (
            f"; {number(int(cost['spp']))} spp, {number(float(cost['seconds']), 3)} s, "
            f"relative standard error {100 * float(cost['relative_error']):.1f} % (median pixel)"
        )
    return text


def alt_text(run: RunData, row: dict[str, Any]) -> str:
    """What a screen reader says of a picture: what it shows, and its mean colour in words."""
    title = str(run.config.get("title") or run.manifest.get("name", "picture"))
    if isinstance(row.get("baseline"), str):
        return f"{title}: the {_MODELS.get(row['baseline'], row['baseline'])} model in the same scene"
    colours = run.table("colours")
    words = ""
    if len(colours):
        tissue = row.get("tissue")
        same = (colours["reading"] == row["reading"]) & (colours["route"] == row["route"])
        same &= colours["tissue"].isna() if pd.isna(tissue) else colours["tissue"] == tissue
        if same.any():
            c = colours[same].iloc[0]
            words = f", {colour_words(float(c['L']), float(c['chroma']), float(c['hue']))} (mean {c['sRGB']})"
    route = ROUTES.get(str(row["route"]), str(row["route"]))
    return f"{title}: rendering, {name_of(row, own_name(run))} reading, {route}{words}"


def colour_words(lightness: float, chroma: float, hue: float) -> str:
    """A CIELAB colour in plain words (own bounds; hue in degrees).

    >>> colour_words(25.0, 20.0, 40.0), colour_words(80.0, 2.0, 90.0)
    ('dark reddish brown', 'very light grey')
    """
    depth = (
        "very dark" if lightness < 12 else "dark" if lightness < 40 else "medium" if lightness < 62
        else "light" if lightness < 78 else "very light"
    )  # fmt: skip
    if chroma < 5:
        return f"{depth} grey"
    brown = lightness < 62
    bounds = (
        (15.0, "purplish red"),
        (30.0, "red"),
        (58.0, "reddish brown" if brown else "reddish orange"),
        (75.0, "brown" if brown else "orange"),
        (100.0, "olive brown" if brown else "yellow"),
        (200.0, "green"),
        (290.0, "blue"),
        (345.0, "purple"),
        (361.0, "purplish red"),
    )
    return f"{depth} {next(name for limit, name in bounds if hue % 360.0 < limit)}"


def findings(run: RunData) -> list[str]:
    """What colour each picture is in words, and each failed claim with what its colour comes from."""
    colours, claims, optics = run.table("colours"), run.claims, run.table("optics")
    said = []
    if len(colours):
        first = colours["route"].iloc[0]
        parts = [
            f"{name_of(r, own_name(run))}: {colour_words(float(r['L']), float(r['chroma']), float(r['hue']))}"
            for r in colours[colours["route"] == first].to_dict("records")
        ]
        said.append("In words, the lit body's mean colour is: " + "; ".join(parts) + ".")
    if not len(claims):
        return said
    failed = claims[claims["verdict"] == "FAIL"]
    readings = [str(r["name"]) for r in run.config.get("reading", [])]
    grouped: dict[str, list[tuple[str, str]]] = {}
    for c in failed.to_dict("records"):
        name = str(c["criterion"])
        text = f"{name} is {number(float(c['value']), 3)}, {_not(c)}"
        reading = next((r for r in sorted(readings, key=len, reverse=True) if r in name), "")
        grouped.setdefault(reading, []).append((name, text))
    for reading, texts in grouped.items():
        said.append("Fails: " + "; ".join(text for _, text in texts) + ".")
        if reading and len(optics):
            said[-1] += _why(run, optics, reading, [name for name, _ in texts])
    return said


def _not(claim: Mapping[Any, Any]) -> str:
    """What a claim that fails is not: "outside 15 to 60", "not at most 8"."""
    words = wanted_words({k: claim[k] for k in ("at_least", "at_most")}, 3)
    return f"not {words}" if words.startswith("at ") else f"outside {words}"


def _why(run: RunData, optics: pd.DataFrame, reading: str, claims: list[str]) -> str:
    """What the colour of a reading comes from, at the channels' middles, from red to blue."""
    about = [c for c in claims if not c.startswith(("seconds", "speed", "memory", "relative error"))]
    if not about:
        return ""
    mine = optics[optics["reading"] == reading].assign(tissue=tissues(optics))
    mine = mine.sort_values("wavelength_nm", ascending=False)
    told = []
    for tissue, rows in mine.groupby("tissue", sort=False):
        if tissue and not any(str(tissue) in c for c in about):
            continue
        absorbed = " / ".join(number(float(v), 2) for v in rows["absorption_per_mm"])
        scattered = " / ".join(number(float(v), 2) for v in rows["reduced_scattering_per_mm"])
        text = f"µa {absorbed} and µs' {scattered} per mm"
        kept = rows["kept_by_redirection"].dropna()
        if len(kept) and float(kept.iloc[0]) < 1:
            text += f", each redirection keeping {100 * float(kept.iloc[0]):.0f} % of the light"
        if "depth_above" in rows and rows["depth_above"].notna().all():
            depth = " / ".join(number(float(v), 2) for v in rows["depth_above"])
            text += f", {above(run)} above scatters with a reduced depth of {depth}"
        told.append(f"{str(tissue) or own_name(run)}: {text}" if tissue or own_name(run) else text)
    return f" Red / green / blue, {last_layer(run)} under this reading: " + "; ".join(told) + "." if told else ""
