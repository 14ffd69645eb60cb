"""`livlab stress` and the report's section."""

import csv
import json
import sys

import pandas as pd
import pytest
from typer.testing import CliRunner

from livlab.cli.app import app, main
from livlab.reports.stress import hard_cases
from livlab.stress import catalogue
from livlab.stress.catalogue import Case, Expectation
from livlab.stress.run import COLUMNS


def call(*arguments):
    return CliRunner().invoke(app, ["stress", *arguments])


def test_table_and_csv(tmp_path):
    file = tmp_path / "stress.csv"
    done = call("--only", "fresnel/[irp]*", "-o", str(file))
    assert done.exit_code == 0, done.output
    assert "fresnel/index match" in done.output
    assert "FAIL" not in done.output
    with file.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.reader(stream))
    assert tuple(rows[0]) == COLUMNS
    assert rows[0][:7] == ["criterion", "value", "standard_error", "reference", "tolerance", "verdict", "seconds"]
    for row in rows[1:]:
        value, error, reference, tolerance = (float(x) for x in row[1:5])
        assert row[5] == "PASS"
        assert error == 0.0
        assert abs(value - reference) <= tolerance + 4e-16 * abs(reference)


def test_json():
    done = call("--only", "metrics/flat", "--json")
    assert done.exit_code == 0
    records = json.loads(done.output)
    assert {r["quantity"] for r in records} == {"same", "step", "refused"}
    assert all(r["verdict"] == "PASS" and r["what"] and r["trusted_by"] for r in records)


def wrong():
    """A case that claims that glass reflects everything."""
    args = {"n_from": 1.0, "n_to": 1.5, "mu": 1.0}
    expect = [Expectation(quantity="reflectance", value=1.0, by="nobody")]
    return Case(name="fresnel/[wrong]", what="a wrong claim", run="fresnel", args=args, expect=expect)


def test_a_failure_is_told_and_is_the_exit_status(monkeypatch, tmp_path):
    monkeypatch.setattr(catalogue, "cases", lambda: (wrong(),))
    done = call("-o", str(tmp_path / "x.csv"))
    assert done.exit_code == 1
    assert "FAIL fresnel/[wrong]: reflectance: a wrong claim" in done.output
    section = hard_cases(pd.read_csv(tmp_path / "x.csv"))
    assert section.content[-1].rows[0].marked
    assert "1 FAIL" in section.content[0].text


def test_a_folder_that_is_not_there_is_told_before_the_work(monkeypatch, capsys, tmp_path):
    file = tmp_path / "none" / "x.csv"
    monkeypatch.setattr(sys, "argv", ["livlab", "stress", "--only", "fresnel", "-o", str(file)])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    told = capsys.readouterr()
    assert "output" in told.err
    assert "fresnel" not in told.out


def test_an_unknown_pattern_names_the_topics(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["livlab", "stress", "--only", "gravity"])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    assert "mie" in capsys.readouterr().err


def test_the_report_says_what_the_thesis_does_not_conserve():
    names = ["energy/consistent: balance", "energy/thesis, what Algorithm 2 takes: redirect_loss"]
    table = pd.DataFrame(
        {
            "criterion": names,
            "value": [5e-9, 0.0417],
            "standard_error": [0.0, 1e-4],
            "reference": [0.0, 0.042],
            "tolerance": [1e-5, 8e-4],
            "verdict": ["PASS", "PASS"],
            "seconds": [1.0, 2.0],
            "difference": [5e-9, -3e-4],
            "at": [None, "wavelength_nm = 600.0"],
            "what": ["a", "b"],
            "trusted_by": ["energy", "adding–doubling"],
            "note": [None, None],
        }
    )
    section = hard_cases(table)
    told = " ".join(x.text for x in section.content[:2])
    assert "Algorithm 2" in told
    assert "0.04170 ± 0.00010" in told
    assert "600.0 nm" in told
    assert len(section.content[-1].rows) == 2
    assert not hard_cases(pd.DataFrame()).content
