"""Fits, studies and the dossier, like every page, show a user's words as words: labels, titles, notes, datasets."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from dossier_fakes import DOSSIER, write_dossier, write_run
from study_texts import BLOOD, MEAN, OXYGEN, TISSUE, text
from test_hostile_text import EVIL, copied, every_text_cell, poison, tame

from livlab.config import parse_experiment
from livlab.criteria import Claim
from livlab.datasets.add import add
from livlab.datasets.draft import read_draft
from livlab.dossier.baseline import Baseline, compare, told
from livlab.dossier.build import build_dossier
from livlab.dossier.config import load_dossier
from livlab.dossier.validate import Ended, planned, record
from livlab.errors import InputError
from livlab.kinds.execute import execute
from livlab.kinds.report import build_report

MARK = "window.hit=1"


def label(number: int) -> str:
    """A label of at most 80 letters that is everything at once: markup, quotes, mathematics, a template's."""
    return f"{number}\"'><script>{MARK};alert(1)</script>{{{{7*7}}}} $\\x{{$ costs $5]]>--> [bold]"


def labelled(source: str, number: int) -> str:
    return re.sub(r'label = "[^"]*"', lambda _: f"label = {json.dumps(label(number))}", source)


REFERENCE = f"""
[[reference]]
label = {json.dumps(label(1))}
dataset = "evil"
column = "reflectance"
"""
RMSE = f'[[output]]\nmetric = "rmse"\nagainst = {json.dumps(label(1))}\nlabel = {json.dumps(label(4))}\n'
CLAIM = f"""
[[criterion]]
output = {json.dumps(label(4))}
statistic = "total"
of = {json.dumps(label(2))}
reference = 0.5
tolerance = 1.0
"""
TARGET = (
    '[ablation]\nbases = ["thesis"]\ntowards = "consistent"\noptions = ["redirect_factor"]\n'
    f"[[ablation.target]]\noutput = {json.dumps(label(4))}\nvalue = 0.5\ntolerance = 1e-9\n"
)
FIT = f"""
schema = 1
kind = "fit"
name = "small"
seed = 3
[wavelengths]
list_nm = [520, 560, 600, 640, 700]
[instrument]
kind = "hyperspectral-camera"
acceptance_deg = 60.0
[search]
standard_error = 2e-2
starts = 1
max_evaluations = 60
most_recordings = 2
[[measurement]]
label = {json.dumps(label(1))}
dataset = "evil"
column = "reflectance"
[[criterion]]
metric = "rmse"
of = {json.dumps(label(1))}
reference = 0.0
tolerance = 0.5
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A run folder of each kind, every free word of whose experiment and dataset is hostile."""
    base = tmp_path_factory.mktemp("studies")
    table = base / "t.csv"
    table.write_text(
        "wavelength_nm,reflectance\n" + "".join(f"{x},{0.02 + (x - 500) / 2000}\n" for x in range(500, 721, 20))
    )
    blood, oxygen = labelled(BLOOD, 2), labelled(OXYGEN, 3)
    sources = {
        "sweep": text("sweep", blood, oxygen, REFERENCE, MEAN, RMSE),
        "sensitivity": text("sensitivity", blood, oxygen, REFERENCE, MEAN, RMSE, CLAIM, "[sensitivity]\npoints = 8"),
        "ablation": text("ablation", REFERENCE, RMSE, TARGET),
        "fit": FIT + TISSUE + re.sub(r"count = \d+\n", "", blood).replace("[[factor]]", "[[parameter]]"),
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LIVLAB_DATA", str(base / "data"))
        add(
            read_draft(table, columns=["reflectance:1"]), name="evil", title=EVIL, source=EVIL, kind="tabulated",
            licence=EVIL, uncertainty=EVIL, notes=EVIL,
        )  # fmt: skip
        return {
            kind: execute(parse_experiment(source), base=base / kind, report=False).folder
            for kind, source in sources.items()
        }


@pytest.mark.parametrize("kind", ["fit", "sweep", "sensitivity", "ablation"])
def test_labels_titles_and_sources_stay_words(made: dict[str, Path], kind: str, tmp_path: Path) -> None:
    folder = poison(copied(made, kind, tmp_path))
    words = tame(build_report(folder).read_text(encoding="utf-8"))
    for number in {"fit": (1, 2), "sweep": (1, 2, 3, 4), "sensitivity": (2, 3, 4), "ablation": (4,)}[kind]:
        assert label(number) in words, number
    assert words.count(EVIL) >= 4
    drawings = list((folder / "figures").glob("*.svg"))
    assert drawings
    for drawing in drawings:
        assert "<script" not in drawing.read_text(encoding="utf-8")
    if kind != "ablation":  # whose figures show the options' names alone
        assert any(MARK in d.read_text(encoding="utf-8") for d in drawings)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["fit", "sweep", "sensitivity", "ablation"])
def test_every_cell_of_words_is_escaped_or_refused(made: dict[str, Path], kind: str, tmp_path: Path) -> None:
    shown = 0
    for table in sorted(made[kind].glob("*.csv")):
        folder = copied(made, kind, tmp_path / table.stem)
        if every_text_cell(folder, folder / table.name):
            try:
                page = build_report(folder).read_text(encoding="utf-8")
            except InputError as error:  # words that the page looks up are no longer found
                assert error.remedy
                continue
            shown += EVIL in tame(page)
    assert shown >= 2


def test_a_dossier_stays_words(tmp_path: Path) -> None:
    hostile = re.sub(
        r'^(title|description|why|text|line|what|shows|deviation|missing|printed|name = "Fig\. \d") = ?.*$',
        lambda found: f"{found[1].split(' ')[0]} = {json.dumps(EVIL)}",
        DOSSIER,
        flags=re.MULTILINE,
    ).replace('name = "Fig. ', f'name = {json.dumps(EVIL)} # "')
    file = write_dossier(tmp_path, hostile)
    for one in file.parents[1].glob("*.toml"):
        one.write_text(re.sub(r"^title = .*$", lambda _: f"title = {json.dumps(EVIL)}", one.read_text(), flags=re.M))
    claims = (
        Claim.of(f"slope {EVIL}", 2.02, 0.01, 2.0, 0.1, seconds=1.5),
        Claim.of("slope", 2.02, 0.01, 2.0, 0.1, seconds=1.5),
        Claim.missing(f"depth {EVIL}", EVIL, reference=1.0, tolerance=0.1),
    )
    run = write_run(tmp_path / "runs" / "one", claims=claims, notes=[EVIL], digest=EVIL, livlab=EVIL, title=EVIL)
    for table in ("table.csv", "plan.csv"):
        every_text_cell(run, run / table)
    ended = {
        "one": Ended("complete", folder=run, seconds=12.5, processor_seconds=20.0),
        "two": Ended("failed", EVIL, seconds=3.0),
        "unlisted": Ended("complete", folder=write_run(tmp_path / "runs" / "unlisted", "unlisted", ()), cached=True),
    }
    dossier, out = load_dossier(file), tmp_path / "site"
    out.mkdir()
    held = Baseline({"one": (f"lost {EVIL}",), "two": (EVIL,)}, {f"one: {EVIL}": EVIL}, EVIL)
    changed = compare(held, ended, dossier.unrecorded)
    data = record(dossier, planned(dossier, file), ended, told(held, *changed), out)
    (out / "validation.json").write_text(json.dumps(data))
    build_dossier(out)
    said = {page.name: tame(page.read_text(encoding="utf-8")) for page in out.glob("*.html")}
    for name in ("index.html", "thesis.html", "curves.html"):
        assert said[name].count(EVIL) >= 3, name


@pytest.mark.parametrize("damage", [lambda s: s.replace("&lt;script", "<script"), lambda s: s + EVIL])
def test_words_that_were_let_through_are_found(
    made: dict[str, Path], damage: Callable[[str], str], tmp_path: Path
) -> None:
    page = build_report(poison(copied(made, "sweep", tmp_path))).read_text(encoding="utf-8")
    with pytest.raises(AssertionError):
        tame(damage(page))
