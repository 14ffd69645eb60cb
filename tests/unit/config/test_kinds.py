"""The table of kinds: every row leads somewhere, and one that does not is refused when it is made."""

from __future__ import annotations

import re
from typing import Any, get_args

import pytest

from livlab.config import KINDS, Experiment, Kind

ROW: dict[str, Any] = {"config": "a.b:C", "job": "a.b:d", "report": "a.b:e", "main_table": "f"}


@pytest.mark.parametrize("name", KINDS)
def test_every_part_of_a_kind_is_there(name: str) -> None:
    kind = KINDS[name]
    model = kind.load_config()
    assert issubclass(model, Experiment)
    assert get_args(model.model_fields["kind"].annotation) == (name,)
    assert callable(kind.load_job())
    assert callable(kind.load_report())


@pytest.mark.parametrize(
    ("part", "value"),
    [
        ("main_table", ""),
        ("main_table", ()),
        ("main_table", ("spectra", "")),
        ("main_table", "spectra.csv"),
        ("report", "livlab.reports.page"),
        ("job", ""),
        ("config", ":C"),
    ],
)
def test_a_row_that_leads_nowhere_is_refused(part: str, value: Any) -> None:
    with pytest.raises(ValueError, match=re.escape(repr(value))):
        Kind(**{**ROW, part: value})


def test_a_kind_without_a_main_table_cannot_be_made() -> None:
    with pytest.raises(TypeError, match="main_table"):
        Kind(ROW["config"], ROW["job"], ROW["report"])  # type: ignore[call-arg]


def test_one_table_or_the_first_of_several() -> None:
    assert Kind(**ROW).main_tables == ("f",)
    assert Kind(**{**ROW, "main_table": ("f", "g")}).main_tables == ("f", "g")
