"""Readings: every row of the table is an option, and an option alone can be set."""

import re
from pathlib import Path
from typing import get_args

import pytest
from pydantic import ValidationError

from livlab.errors import ConfigError, InputError
from livlab.model.tissue.optics import coefficients
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import BASES, READINGS, Reading, reading, rows

OPTIONS = [k for k in Reading.model_fields if k not in {"base", "name"}]


def test_every_row_of_the_table_is_an_option_and_every_option_a_row():
    table = rows()
    assert set(table["row"].dropna()) == set(range(1, 18))
    assert sorted(table["option"]) == sorted(OPTIONS)
    assert (table[["text", "trouble", "choices"]] != "").all().all()


def test_the_document_explains_every_option_and_every_choice():
    text = (Path(__file__).parents[4] / "docs" / "readings.md").read_text(encoding="utf-8")
    for _, row in rows().iterrows():
        assert f"`{row['option']}`" in text
        for choice in row["choices"].split(", "):
            assert re.search(rf"`{re.escape(choice)}`", text), f"{row['option']} = {choice}"


def test_the_readings_choose_as_the_table_says():
    table = rows().set_index("option")
    expected = {
        "fibre_density": ("areal", "cylinder"),
        "elastin_index": ("absolute", "relative"),
        "small_fibre_law": ("rayleigh", "mie"),
        "elastin_refractive_index": (1.5, 1.534),
        "hepatocyte_axes": ("diameters", "semi_axes"),
        "hepatocyte_rate": ("log10", "linear"),
        "hepatocyte_absorption": ("free_path", "albedo"),
        "redirect_factor": ("abs_cos", "none"),
        "scattering_phase": ("isotropic", "element"),
    }
    differ = table["thesis"] != table["consistent"]
    assert set(table.index[differ]) == set(expected)
    for option, (printed, mended) in expected.items():
        assert (table.loc[option, "thesis"], table.loc[option, "consistent"]) == (printed, mended)
    assert list(table.index[table["consistent"] != table["measured"]]) == [
        "fibre_hydration",
        "parenchyma_scattering",
    ]
    assert table.loc["parenchyma_scattering", "measured"] == "published"
    assert table.loc["fibre_hydration", "measured"] == "hydrated"


def test_a_reading_of_ones_own_takes_the_rest_from_its_base():
    made = Reading.model_validate({"base": "thesis", "elastin_index": "relative"})
    assert made.name == "thesis, elastin_index relative"
    assert {k for k in OPTIONS if getattr(made, k) != getattr(READINGS["thesis"], k)} == {"elastin_index"}
    assert Reading.model_validate("thesis") == READINGS["thesis"]
    assert reading("thesis", name="mine").name == "mine"
    assert "mine" in rows(reading("thesis", name="mine"))


def test_a_reading_written_out_reads_back_equal():
    for name in BASES:
        made = reading(name)
        assert Reading.model_validate(made.model_dump(mode="json")) == made
        assert Reading.model_validate_json(made.model_dump_json()) == made


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fibre_densty": "areal"}, "fibre_densty.*Did you mean 'fibre_density'"),
        ({"fibre_density": "sphear"}, "fibre_density.*Did you mean 'sphere'"),
        ({"elastin_refractive_index": 1.6}, "1.5, 1.534"),
        ({"blood_fraction": 0.5}, "0.084, 0.034"),
    ],
)
def test_unknown_options_and_values_are_refused_with_a_hint(options, message):
    with pytest.raises(ConfigError, match=f"(?s){message}"):
        reading("consistent", **options)


def test_unknown_readings_are_refused_with_a_hint():
    with pytest.raises(InputError, match="Did you mean 'thesis'"):
        reading("thesys")
    with pytest.raises(ValidationError, match="base"):
        Reading.model_validate({"base": "thesys"})


def test_the_schema_requires_nothing_and_lists_the_choices():
    schema = Reading.model_json_schema()
    assert "required" not in schema
    assert schema["properties"]["elastin_refractive_index"]["enum"] == [1.5, 1.534]
    assert schema["properties"]["fibre_density"]["enum"] == ["areal", "cylinder", "sphere"]


def _alternatives(option):
    if option in {"elastin_refractive_index", "blood_fraction"}:
        return Reading.model_fields[option].json_schema_extra["enum"]
    return get_args(Reading.model_fields[option].annotation)


# The first base where the option has an effect; the options about the dipole and the walk's draws act elsewhere.
ELSEWHERE = {"riccati_bessel", "dipole_distance", "index_labels", "sphere_limit", "zero_draw"}


@pytest.mark.parametrize("option", [o for o in OPTIONS if len(_alternatives(o)) > 1])
def test_each_option_set_alone_changes_the_stack(option):
    base = "measured" if option == "published_scattering" else "thesis"
    state = "in_vivo" if option == "in_vivo_vessel_radius_unit" else "ex_vivo"
    tissue = load_preset("liver", state=state)
    seen = []
    for value in _alternatives(option):
        # Spheres keep this quick; the cylinder is compared with them where the option is the fibres' density.
        options = {"fibre_density": "sphere"} if base == "measured" else {}
        found = coefficients(tissue, reading(base, **options | {option: value}), [540.0])
        seen.append(found)
    for k, one in enumerate(seen):
        for other in seen[k + 1 :]:
            assert not one.drop_attrs().identical(other.drop_attrs()), option


def test_options_with_one_choice_are_those_that_act_elsewhere():
    assert {o for o in OPTIONS if len(_alternatives(o)) == 1} == ELSEWHERE
