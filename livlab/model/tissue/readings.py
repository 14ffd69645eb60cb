"""Readings of the thesis: where its text contradicts itself or physics, a named choice on every line.

`thesis` keeps the text, made runnable; `consistent` mends units and physics and keeps the thesis's elements;
`measured` is `consistent` with measured numbers in place of two of the thesis's: published scattering of liver for the
hepatocyte's, and the index of hydrated collagen for the dry fibres'.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args

import pandas as pd
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from livlab.config.errors import explain, nearest
from livlab.errors import InputError

ReadingName = Literal["thesis", "consistent", "measured"]


def _one_of(*allowed: float) -> Callable[[float], float]:
    def check(value: float) -> float:
        if value not in allowed:
            raise InputError.of(
                "value", value, f"must be one of {', '.join(f'{x:g}' for x in allowed)}", "Pick one, or set the tissue."
            )
        return value

    return check


def _number(*allowed: float, default: float, text: str) -> Any:
    return Field(default=default, description=text, json_schema_extra={"enum": list(allowed)})


def _all_optional(schema: dict[str, Any]) -> None:
    """A reading given in a file takes what it leaves out from its base, so nothing is required."""
    schema.pop("required", None)
    for prop in schema.get("properties", {}).values():
        prop.pop("default", None)


class Reading(BaseModel):
    """One reading: a choice on every row of the table of contradictions. What is left out comes from `base`.

    Examples
    --------
    >>> Reading.model_validate({"base": "thesis", "elastin_index": "relative"}).fibre_density
    'areal'
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, validate_default=True, json_schema_extra=_all_optional
    )

    base: ReadingName = Field(
        "consistent", description="The reading that supplies what is left out; consistent if not said."
    )
    name: str = Field(
        "", max_length=120, description="How reports call it; the base and the changes to it if not said."
    )
    riccati_bessel: Literal["z_jn"] = Field("z_jn", description="ψ of eq. 3.7: z·j_n, the Riccati–Bessel function.")
    mie_wavenumber: Literal["medium", "vacuum"] = Field(
        "medium", description="k of eq. 6.6: in the medium (an efficiency), or in vacuum (η² too large)."
    )
    fibre_density: Literal["areal", "cylinder", "sphere"] = Field(
        "cylinder",
        description="σ_s of a fibre: areal Q f as a number in 1/cm; cylinder 4 Q f/(π d); sphere 3 Q f/(2 d).",
    )
    elastin_index: Literal["absolute", "relative"] = Field(
        "relative", description="Index in eq. 6.8 of the fibres under Rayleigh's law: η as printed, or η/η_med."
    )
    small_fibre_law: Literal["rayleigh", "mie"] = Field(
        "mie", description="Law of the fibres to which the thesis gives Rayleigh's: as printed, or the exact one."
    )
    elastin_refractive_index: Annotated[float, AfterValidator(_one_of(1.5, 1.534))] = _number(
        1.5, 1.534, default=1.534, text="η of elastin: 1.5 (Table 7.1) or 1.534 (prose)."
    )
    fibre_hydration: Literal["dry", "hydrated"] = Field(
        "dry", description="Index of the fibres: as tabled (dry), or hydrated as in living tissue (1.43)."
    )
    lipid_bile: Literal["table", "prose"] = Field(
        "table", description="Lipid and bile: 0.019 of lipid+water and 0.039 (table), or 3.9 % and 1.9 % (prose)."
    )
    hepatocyte_axes: Literal["diameters", "semi_axes"] = Field(
        "semi_axes", description="a, b of eq. 6.16: the cell's diameters as printed, or its semi-axes."
    )
    hepatocyte_rate: Literal["log10", "linear"] = Field(
        "linear", description="Free path at hepatocytes: 1/log10(σ_t+1) per cm (eq. 6.19), or σ_t (eq. 6.18)."
    )
    hepatocyte_absorption: Literal["free_path", "albedo"] = Field(
        "albedo", description="Absorbed if the free path is below the mean diameter (Alg. 1), or by an albedo."
    )
    redirect_factor: Literal["abs_cos", "cos", "clamped_cos", "none"] = Field(
        "none", description="Factor on the intensity at a redirection (Alg. 2): |cos θ|, cos θ, max(0, cos θ), none."
    )
    scattering_phase: Literal["isotropic", "element"] = Field(
        "element", description="New direction: uniform (Alg. 2), or by each element's own phase function."
    )
    dipole_distance: Literal["sum"] = Field("sum", description="d_r of eq. 5.5: √(r² + z²).")
    index_labels: Literal["bohren_huffman"] = Field(
        "bohren_huffman", description="η under eq. 3.9–3.10: particle and medium as in Bohren & Huffman."
    )
    sphere_limit: Literal["limit"] = Field("limit", description="asin(c)/c of eq. 6.16 at a = b: its limit, 1.")
    zero_draw: Literal["open_interval"] = Field(
        "open_interval", description="ξ of eq. 6.18: 1 − u with u in [0, 1); σ = 0 never interacts."
    )
    in_vivo_vessel_radius_unit: Literal["cm", "mm", "um"] = Field(
        "cm", description='Unit of "R 0.004" in vivo: cm (40 µm), mm (4 µm) or µm (0.004 µm).'
    )
    blood_fraction: Annotated[float, AfterValidator(_one_of(0.084, 0.034))] = _number(
        0.084, 0.034, default=0.084, text="f_blood ex vivo: 0.084 (Table 7.1) or 0.034 (haemoglobin ex vivo, prose)."
    )
    parenchyma_scattering: Literal["hepatocyte", "published"] = Field(
        "hepatocyte", description="What scatters in the parenchyma: hepatocytes, or published liver scattering."
    )
    published_scattering: Literal[
        "alexandrakis2005", "parsa1989", "parsa1989_rayleigh_mie", "yi_backman2012", "soft_tissue_mean"
    ] = Field("alexandrakis2005", description="Which published µs' (Jacques 2013) when it is used.")

    @model_validator(mode="before")
    @classmethod
    def _from_base(cls, data: Any) -> Any:
        if isinstance(data, str):
            data = {"base": data}
        if not isinstance(data, Mapping):
            return data
        base = data.get("base", "consistent")
        known = BASES.get(base) if isinstance(base, str) else None
        if known is None:
            return data
        changes = [f"{k} {v}" for k, v in data.items() if k not in {"base", "name"} and known.get(k) != v]
        name = f"{base}, {', '.join(changes)}" if changes else str(base)
        return {"name": name[:120], **known, **data, "base": base}


_MENDED: dict[str, Any] = {k: f.default for k, f in Reading.model_fields.items() if k not in {"base", "name"}}
_PRINTED: dict[str, Any] = {
    "fibre_density": "areal",
    "elastin_index": "absolute",
    "small_fibre_law": "rayleigh",
    "elastin_refractive_index": 1.5,
    "hepatocyte_axes": "diameters",
    "hepatocyte_rate": "log10",
    "hepatocyte_absorption": "free_path",
    "redirect_factor": "abs_cos",
    "scattering_phase": "isotropic",
}
BASES: dict[str, dict[str, Any]] = {
    "thesis": _MENDED | _PRINTED,
    "consistent": _MENDED,
    "measured": _MENDED | {"parenchyma_scattering": "published", "fibre_hydration": "hydrated"},
}
"""The options of each named reading."""


def reading(name: str, /, **overrides: Any) -> Reading:
    """A named reading, with single options changed.

    Parameters
    ----------
    name
        "thesis", "consistent" or "measured".
    overrides
        Options of `Reading` and their values.

    Raises
    ------
    ConfigError
        An unknown reading, option or value.

    Examples
    --------
    >>> reading("thesis", redirect_factor="cos").name
    'thesis, redirect_factor cos'
    """
    if name not in BASES:
        raise InputError.of(
            "reading",
            name,
            f"must be one of {', '.join(get_args(ReadingName))}",
            nearest(name, BASES) or "Pick one.",
        )
    data = {**overrides, "base": name}
    try:
        return Reading.model_validate(data)
    except ValidationError as error:
        raise explain(error, data, "", Reading.model_json_schema(), f"reading {name!r}") from None


READINGS: dict[str, Reading] = {name: reading(name) for name in BASES}
"""The three readings that every report shows side by side."""


Subject = Literal["fibres", "cells", "stand-ins", "choices", "walk"]
"""What of a tissue a row speaks of: elements of a kind, elements that stand in for others, the tissue's own choices, or
the walk, which every tissue has."""


@dataclass(frozen=True)
class Contradiction:
    """A row of the table of contradictions: number, option, what the text says, the trouble, and what it speaks of."""

    number: int | None
    option: str
    text: str
    trouble: str
    of: Subject = "walk"


_ROWS: tuple[Contradiction, ...] = (
    Contradiction(1, "riccati_bessel", "eq. 3.7: ψ = j_n", "the Riccati–Bessel function is z·j_n", of="fibres"),
    Contradiction(
        2,
        "mie_wavenumber",
        "eq. 6.6: k in vacuum",
        "Q needs k in the medium, else it is not an efficiency",
        of="fibres",
    ),
    Contradiction(
        3,
        "fibre_density",
        "eq. 6.3 · 6.7: Q p π r² with p per area",
        "the product is Q f_v and has no unit; the text says 1/cm",
        of="fibres",
    ),
    Contradiction(
        4, "elastin_index", "eq. 6.8: absolute η", "must be η/η_med; as printed Q reaches about 70", of="fibres"
    ),
    Contradiction(
        5, "small_fibre_law", "Rayleigh for d = 0.5 µm", "the text itself asks for r < λ/10; x is about 4", of="fibres"
    ),
    Contradiction(6, "elastin_refractive_index", "1.534 in the prose, 1.5 in Table 7.1", "two values", of="choices"),
    Contradiction(
        None,
        "fibre_hydration",
        "Table 7.1: η of 1.5 in water",
        "that of dry fibres; hydrated collagen has 1.43, dry 1.53 (Wang 1996, 850 nm)",
        of="choices",
    ),
    Contradiction(
        7,
        "lipid_bile",
        "lipids and bile 3.9 % and 1.9 % in the prose, 0.019 and 0.039 in Table 7.1",
        "swapped; by eq. 6.14 f_L is a share of f_LA",
        of="choices",
    ),
    Contradiction(
        8,
        "hepatocyte_axes",
        'a, b are "diameters" in eq. 6.16',
        "surface over volume of a spheroid needs semi-axes: a factor 2",
        of="cells",
    ),
    Contradiction(
        9, "hepatocyte_rate", "eq. 6.19: d' grows with σ_t", "more hepatocytes scatter less; no unit", of="cells"
    ),
    Contradiction(
        10,
        "hepatocyte_absorption",
        "Algorithm 1: absorb if d < diameter",
        "compares a penalised length with 20–30 µm",
        of="cells",
    ),
    Contradiction(
        11,
        "redirect_factor",
        "Algorithm 2: intensity *= cos θ, θ uniform in [0, 2π)",
        "the factor has mean zero: every scattered ray averages to nothing, or goes negative",
    ),
    Contradiction(
        11, "scattering_phase", "Algorithm 2: a uniform direction", "the elements' phase functions are left out"
    ),
    Contradiction(12, "dipole_distance", "eq. 5.5: d_r = √(r² − z²)", "must be r² + z²"),
    Contradiction(13, "index_labels", "η under eq. 3.9–3.10", "labels swapped: particle and medium", of="fibres"),
    Contradiction(14, "sphere_limit", "eq. 6.16 for a sphere, a = b", "asin(c)/c is 0/0", of="cells"),
    Contradiction(15, "zero_draw", "eq. 6.18: ξ = 0, σ = 0", "infinite distance"),
    Contradiction(16, "in_vivo_vessel_radius_unit", '"R 0.004" in vivo beside 50 µm ex vivo', "no unit", of="choices"),
    Contradiction(
        17,
        "blood_fraction",
        'blood 8.4 % "in vivo" used for an ex-vivo curve; 3.4 % haemoglobin ex vivo',
        "two values, two states",
        of="choices",
    ),
    Contradiction(
        None,
        "parenchyma_scattering",
        "eq. 6.16: hepatocytes alone scatter",
        "published liver scattering differs",
        of="stand-ins",
    ),
    Contradiction(
        None, "published_scattering", "–", "three published livers: 9.0, 9.2 and 16.5 1/cm at 500 nm", of="choices"
    ),
)


def options_of(parts: Collection[Subject], chosen: Collection[str] = ()) -> tuple[str, ...]:
    """Options that speak of these parts of a tissue, in the table's order; of its choices those that it `chosen`.

    >>> options_of(["walk"])
    ('redirect_factor', 'scattering_phase', 'dipole_distance', 'zero_draw')
    """
    return tuple(row.option for row in _ROWS if row.of in parts or (row.of == "choices" and row.option in chosen))


def rows(*extra: Reading) -> pd.DataFrame:
    """Every row of the table of contradictions and what each reading chooses, for reports.

    Parameters
    ----------
    extra
        Further readings, a column each after the three named ones.

    Returns
    -------
    Columns row (missing where the option is livlab's own), option, text, trouble, choices (what can be set), one
    column a reading, and differs (whether the readings disagree).

    Examples
    --------
    >>> rows().set_index("option").loc["fibre_density", ["thesis", "consistent"]].tolist()
    ['areal', 'cylinder']
    """
    shown = [*READINGS.values(), *(x for x in extra if x.name not in READINGS)]
    made = []
    for row in _ROWS:
        values = {x.name: getattr(x, row.option) for x in shown}
        choices = ", ".join(str(x) for x in _choices(row.option))
        made.append(
            {
                "row": row.number,
                "option": row.option,
                "text": row.text,
                "trouble": row.trouble,
                "choices": choices,
                **values,
                "differs": len(set(values.values())) > 1,
            }
        )
    return pd.DataFrame(made).astype({"row": "Int64"})


def _choices(option: str) -> tuple[Any, ...]:
    field = Reading.model_fields[option]
    if isinstance(field.json_schema_extra, dict):
        return tuple(field.json_schema_extra["enum"])  # type: ignore[arg-type]
    return get_args(field.annotation)
