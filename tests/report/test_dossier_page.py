"""The dossier from a record and run folders alone: nothing missing is silent, nothing comes from outside."""

from __future__ import annotations

import json
import re
from html import unescape
from pathlib import Path

import pytest
from dossier_fakes import ended_three

from livlab.dossier.baseline import Baseline, compare, told
from livlab.dossier.build import build_dossier
from livlab.dossier.config import load_dossier
from livlab.dossier.validate import record
from livlab.errors import InputError

HELD = Baseline({"one": ("slope", "height"), "two": ("was true",)}, {}, "baseline.json")


def build(base: Path, held: Baseline = HELD) -> Path:
    file, experiments, ended = ended_three(base)
    dossier = load_dossier(file)
    out = base / "site"
    out.mkdir(exist_ok=True)
    changed = compare(held, ended, dossier.unrecorded)
    data = record(dossier, experiments, ended, told(held, *changed), out)
    (out / "validation.json").write_text(json.dumps(data))
    return build_dossier(out)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("dossier")).parent


def words(site: Path, page: str) -> str:
    """Text of a page without its tags, spaces joined."""
    text = (site / page).read_text(encoding="utf-8")
    return re.sub(r"\s+", " ", unescape(re.sub(r"<style>.*?</style>|<[^>]+>", " ", text, flags=re.DOTALL)))


def test_every_claim_stands_on_the_index_with_its_verdict_and_cost(site: Path) -> None:
    text = words(site, "index.html")
    assert re.search(r"slope ✓ PASS one 2\.020 ± 0\.010 2 ± 0\.1 1\.5", text)
    assert re.search(r"height ✗ FAIL one 9\.00 ± 0\.50 1 ± 2 2", text)
    assert re.search(r"depth the <reference> is not to be had \? MISSING one not available 1 ± 0\.1", text)
    assert "2 PASS" in text  # slope and seconds
    assert "1 FAIL" in text
    assert "2 of 3 have a result" in text


def test_groups_have_their_own_counts_and_the_verdicts_are_told_together(site: Path) -> None:
    text = words(site, "index.html")
    assert re.search(r"PASS FAIL TOO CLOSE MISSING Livlab's own checks 2 1 1 Of experiments without a result 1", text)
    assert "2 claims are statistical" in text
    assert "at least one of 2 would be wrong with a chance of up to 4.5 % if they are independent (Šidák)" in text
    assert "1 of them FAIL; none could be a false alarm among so many" in text
    assert re.search(r"height one < 1e-6 < 1e-6 8\.0 s", text)
    assert 'href="claims.csv"' in (site / "index.html").read_text()
    assert (site / "claims.csv").read_text().startswith("experiment,group,criterion,verdict,")


def test_an_experiment_without_a_result_is_missing_everywhere(site: Path) -> None:
    for page in ("index.html", "more.html", "thesis.html"):
        assert "it <broke>: mend it." in words(site, page), page
    index = words(site, "index.html")
    assert "was true it <broke>: mend it. ? MISSING two" in index  # what it claimed when it ran
    assert "MISSING: no result of two." in index
    assert "2 MISSING" in index  # depth, and what two claimed
    assert not (site / "experiments" / "two.html").exists()
    assert 'href="experiments/two.html"' not in (site / "index.html").read_text()


def test_a_missing_experiment_that_nobody_knows_claims_of_counts_too(tmp_path: Path) -> None:
    site = build(tmp_path, Baseline({}, {})).parent
    text = words(site, "index.html")
    assert "MISSING: two has no result, so that none of its claims is known" in text
    assert "2 MISSING" in text
    assert "There is no baseline yet" in text


def test_the_thesis_stands_beside_ours_and_what_has_no_answer_is_missing(site: Path) -> None:
    text = words(site, "thesis.html")
    assert re.search(r"Its slope 2\.0 2\.020 ± 0\.010 ✓ PASS one", text)
    assert re.search(r"Its start 0\.5 0\.510 ± 0\.020 mm – one", text)
    assert re.search(r"Its end 7 one: table\.csv has no such row \? MISSING", text)
    assert "No experiment takes photographs." in text
    assert "Ours rises too." in text
    index = words(site, "index.html")
    assert re.search(r"Fig\. 1: A rising line beside ours 2 of 3", index)
    assert re.search(r"Fig\. 2: A photograph No experiment takes photographs\. \? MISSING", index)
    assert re.search(r"Fig\. 3: What the second finds two: it <broke>: mend it\. \? MISSING", index)


def test_what_held_and_no_longer_does_is_told(site: Path) -> None:
    text = words(site, "index.html")
    assert "2 claims that held no longer hold: see the baseline." in text
    assert "3 claims held when the baseline was recorded (baseline.json)." in text
    assert "its experiment has no result: it <broke>: mend it." in text
    assert "Not recorded: claims named seconds*. Time depends on the machine." in text


def test_groups_show_their_figures_and_what_is_not_listed_has_a_page(site: Path) -> None:
    text = (site / "curves.html").read_text()
    assert text.count("<svg") == 1
    assert 'id="curves-one-line-axes_1"' in text
    assert "var(--ink)" in text
    assert "Note: one thing to <know>" in words(site, "curves.html")
    assert "Look at the line." in words(site, "curves.html")
    assert "one thesis packaging 1" in words(site, "curves.html")  # effects left out
    assert "It makes no claims." in words(site, "rest.html")


def test_every_link_leads_somewhere_and_nothing_comes_from_outside(site: Path) -> None:
    pages = [*site.glob("*.html"), *site.glob("experiments/*.html")]
    assert {p.name for p in pages} == {
        *(f"{n}.html" for n in ("index", "thesis", "curves", "more", "rest", "one", "unlisted"))
    }
    seen = 0
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert "<script" not in text
        for link in re.findall(r'(?:href|src)="([^"]+)"', text):
            if link.startswith("data:"):
                continue
            assert not re.match(r"[a-z]+:|//", link), link
            path, _, anchor = link.partition("#")
            target = (page.parent / path).resolve() if path else page
            assert target.is_file(), (page.name, link)
            if anchor:
                assert f'id="{anchor}"' in target.read_text(encoding="utf-8"), (page.name, link)
            seen += 1
    assert seen > 30


def test_a_report_in_the_site_leads_back(site: Path) -> None:
    assert 'href="../curves.html">A &lt;small&gt; dossier</a>' in (site / "experiments" / "one.html").read_text()


def test_it_comes_again_the_same_and_leaves_nothing_stale(tmp_path: Path) -> None:
    page = build(tmp_path)
    before = {p.name: p.read_bytes() for p in page.parent.rglob("*.html")}
    (page.parent / "old.html").write_text("stale")
    (page.parent / "experiments" / "old.html").write_text("stale")
    build_dossier(page.parent)
    assert {p.name: p.read_bytes() for p in page.parent.rglob("*.html")} == before


def test_a_damaged_run_is_missing_and_a_missing_record_an_error(tmp_path: Path) -> None:
    page = build(tmp_path)
    (tmp_path / "runs" / "one" / "manifest.json").write_text("{")
    text = words(build_dossier(page.parent).parent, "index.html")
    assert "its run folder cannot be read" in text
    assert "no result of one, two" in text
    (page.parent / "validation.json").unlink()
    with pytest.raises(InputError, match="cannot be read"):
        build_dossier(page.parent)


def test_a_figure_that_is_gone_is_told(tmp_path: Path) -> None:
    page = build(tmp_path)
    (tmp_path / "runs" / "one" / "figures" / "line.svg").unlink()
    build_dossier(page.parent)
    assert "MISSING: the run one has no figure line." in words(page.parent, "curves.html")
    assert "MISSING: the run one has no figure line." in words(page.parent, "thesis.html")
