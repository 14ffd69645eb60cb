"""Reports of studies: each method's page is sound, says what was found, and says so where nothing could be."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path

import pandas as pd
import pytest
from study_texts import BLOOD, MEAN, OXYGEN, READING, text

from livlab.config import parse_experiment
from livlab.kinds.execute import execute
from livlab.kinds.report import build_report
from livlab.kinds.study.report import verdict_sentences

PEAK = '[[output]]\nmetric = "peak wavelength"\n'
TARGET = '[ablation]\nbases = ["thesis"]\ntowards = "consistent"\n[[ablation.target]]\noutput = "mean"\n'


class Strict(HTMLParser):
    """Words of a page, and whether its elements close in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text: list[str] = []
        self.ids: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.ids += [str(v) for k, v in attrs if k == "id"]
        if tag not in {"meta", "link", "br", "img", "input", "hr"}:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def page(source: str, base: Path) -> tuple[Path, str]:
    """The run folder and the words of its page."""
    folder = execute(parse_experiment(source), base=base, report=False).folder
    parser = Strict()
    parser.feed(build_report(folder).read_text(encoding="utf-8"))
    assert not parser.open
    assert len(parser.ids) == len(set(parser.ids))
    return folder, " ".join(" ".join(parser.text).split())


def test_a_grid_of_two_is_a_heat_map_and_names_its_extremes(tmp_path: Path) -> None:
    folder, words = page(text("sweep", BLOOD, OXYGEN, MEAN), tmp_path)
    assert {p.stem for p in (folder / "figures").glob("*.svg")} >= {"curves-0", "curves-1", "heat-0"}
    table = pd.read_csv(folder / "results.csv")
    assert f"least {table['mean'].min():.4g} at blood 0.1" in words
    assert "layers.pulp.elements.blood.fraction" in words


def test_words_as_factors_are_scattered_and_not_mapped(tmp_path: Path) -> None:
    folder, words = page(text("sweep", BLOOD, READING, MEAN, '[sweep]\ndesign = "sobol"\npoints = 8'), tmp_path)
    names = {p.stem for p in (folder / "figures").glob("*.svg")}
    assert "scatter-0" in names
    assert "heat-0" not in names
    assert "hepatocyte, published" in words


def test_indices_are_shown_and_undefined_ones_are_said(tmp_path: Path) -> None:
    folder, words = page(text("sensitivity", BLOOD, OXYGEN, MEAN, PEAK, "[sensitivity]\npoints = 8"), tmp_path)
    assert {p.stem for p in (folder / "figures").glob("*.svg")} >= {"indices", "settling", "scatter-0"}
    assert "The indices of peak wavelength are undefined: peak wavelength: '700 at every point': is flat" in words
    assert "Most by total index. Mean: blood (" in words
    assert "have not settled" in words or "no interval is wider" in words


def test_an_ablation_says_which_cases_explain_the_figures(tmp_path: Path) -> None:
    base = execute(parse_experiment(text("ablation", MEAN, TARGET + "value = 0.5\ntolerance = 1e-9")), base=tmp_path)
    table = pd.read_csv(base.folder / "ablation.csv").set_index("case")
    value = table.loc["thesis", "mean"]
    folder, words = page(text("ablation", MEAN, TARGET + f"value = {value:.9g}\ntolerance = 1e-6"), tmp_path)
    assert "Nearest is “thesis”" in words
    assert "The thesis reading has them all." in words
    assert "hepatocyte_rate" in words
    assert (folder / "figures" / "cases.svg").exists()
    assert "None of" in (base.folder / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(("value", "said"), [(1.0, "1 of 2 different cases has"), (5.0, "None of 2 different cases")])
def test_verdicts_follow_from_the_numbers(value: float, said: str) -> None:
    targets = pd.DataFrame({"output": ["p"], "value": [value], "tolerance": [0.5]})
    rows = []
    for case, group, p in (("a", "base", 1.1), ("a, x", "option", 2.0), ("a, y", "option", 1.1)):
        off = abs(p - value) / 0.5
        twin = "a" if case == "a, y" else None
        rows.append(
            {"case": case, "group": group, "same_as": twin, "p": p, "p error": 0.01, "p off": off, "worst off": off}
        )
    told = verdict_sentences(pd.DataFrame(rows), targets)
    assert told[0].startswith(said)
    assert ("misses p (1.100 ± 0.010, wanted 5)" in told[1]) == (value == 5.0)


def test_no_verdict_without_a_value() -> None:
    targets = pd.DataFrame({"output": ["p"], "value": [1.0], "tolerance": [0.5]})
    table = pd.DataFrame(
        {"case": ["a"], "group": ["base"], "same_as": [None], "p": [float("nan")], "worst off": [float("nan")]}
    )
    assert verdict_sentences(table, targets) == ["No case has a value for every figure, so that none explains them."]
