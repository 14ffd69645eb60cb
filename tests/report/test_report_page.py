"""The page without a browser: what it says, what it escapes, that it is the same twice."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import pytest

from livlab.errors import EnvironmentProblem, InputError
from livlab.kinds.report import build_report

Writer = Callable[..., Path]
VOID = {"meta", "link", "br", "img", "input", "hr"}


class Strict(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open[-1] == tag, f"</{tag}> closes <{self.open[-1]}>"
        self.open.pop()

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def parse(page: Path) -> Strict:
    parser = Strict()
    parser.feed(page.read_text(encoding="utf-8"))
    assert not parser.open
    return parser


def test_a_reviewer_learns_command_processor_and_what_to_ask_for(write_run: Writer) -> None:
    folder = write_run()
    manifest = json.loads((folder / "manifest.json").read_text())
    own = {"haemoglobin_prahl": "a" * 64, "my_liver": "b" * 64, "../no name": "c" * 64}
    told = {"processor": "Zilog Z80", "code": "0123456789abcdef", "seed": 41, "variant": "llvm", "datasets": own}
    (folder / "manifest.json").write_text(json.dumps(manifest | told))
    text = " ".join(" ".join(parse(build_report(folder)).text).split())
    for words in ("Zilog Z80", "0123456789abcdef", "seed 41", "variant llvm", f"livlab rerun {folder.name}"):
        assert words in text, words
    assert "Not livlab's own: my_liver, ../no name." in text


def test_every_claim_and_section_is_on_the_page(plain_report: Path) -> None:
    page = parse(plain_report)
    text = " ".join(" ".join(page.text).split())
    for words in (
        "pearson measured vs human liver 500-720",
        "0.99345 ± 0.00042",
        "1 PASS",
        "1 FAIL",
        "1 MISSING",
        "reference not available",
        "does not conserve energy",
        "elastin: Q = 70 is above its bound",
        "livlab run experiments/spectral.toml",
        "the next digit costs 100×, 21 min",
    ):
        assert words in text, words
    figures = [a for t, a in page.tags if t == "svg"]
    assert len(figures) == 4
    assert all(a["role"] == "img" and a["aria-label"] for a in figures)


def test_a_missing_claim_without_a_reason_says_so(write_run: Writer) -> None:
    folder = write_run()
    manifest = json.loads((folder / "manifest.json").read_text())
    del manifest["claim_notes"]
    (folder / "manifest.json").write_text(json.dumps(manifest))
    assert "the run gave no reason" in build_report(folder).read_text()


def test_ids_are_unique_and_links_inside_the_page_resolve(plain_report: Path) -> None:
    page = parse(plain_report)
    ids = [a["id"] for _, a in page.tags if a.get("id")]
    assert len(ids) == len(set(ids))
    for _, attributes in page.tags:
        target = attributes.get("href") or attributes.get("xlink:href") or ""
        if target.startswith("#"):
            assert target[1:] in ids, target


def test_nothing_on_the_page_asks_for_anything(plain_report: Path) -> None:
    page = parse(plain_report)
    for tag, attributes in page.tags:
        assert tag not in {"script", "iframe", "object", "embed"}
        for name in ("src", "href", "xlink:href", "srcset"):
            value = attributes.get(name) or ""
            assert value.startswith(("#", "data:")) or not value, (tag, name, value)
    assert not re.search(r"@import|url\((?!#)", page_text(page))


def page_text(page: Strict) -> str:
    return " ".join(page.text)


@pytest.mark.parametrize("evil", ["<script>alert(1)</script>", '"><img src=x onerror=alert(1)>', "a & b </title>"])
def test_words_from_a_users_file_are_escaped(write_run: Writer, evil: str) -> None:
    folder = write_run(title=evil, readings=(evil, "measured"), reference=evil, notes=(evil,))
    page = parse(build_report(folder))
    tags = [t for t, _ in page.tags]
    assert "script" not in tags
    assert "img" not in tags
    assert not any(k.startswith("on") for _, a in page.tags for k in a)
    assert evil in "".join(page.text)


def test_the_same_folder_gives_the_same_bytes(write_run: Writer) -> None:
    folder = write_run()
    first = build_report(folder).read_bytes()
    assert build_report(folder).read_bytes() == first
    assert len(first) < 5_000_000
    assert {f.name for f in (folder / "figures").iterdir()} == {
        "curves.svg",
        "absolute.svg",
        "coefficients.svg",
        "energy.svg",
    }


@pytest.mark.parametrize(
    "change",
    [
        {"wavelengths": 1},
        {"reference": None},
        {"claims": False},
        {"readings": ("measured",)},
        {"readings": tuple("abcdefgh")},
        {"result": False, "status": "partial"},
        {"status": "partial"},
    ],
    ids=str,
)
def test_unusual_runs_still_make_a_page(write_run: Writer, change: dict[str, object]) -> None:
    text = build_report(write_run(**change)).read_text(encoding="utf-8")
    assert ("This run is not complete" in text) == (change.get("status") == "partial")
    assert ("makes no claims" in text) == (change.get("claims") is False)


def test_what_is_not_a_run_folder_is_refused(tmp_path: Path, write_run: Writer) -> None:
    with pytest.raises(InputError, match=r"has no manifest\.json"):
        build_report(tmp_path)
    folder = write_run()
    (folder / "claims.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="lacks these columns"):
        build_report(folder)
    (folder / "manifest.json").write_text("{")
    with pytest.raises(InputError, match="is damaged"):
        build_report(folder)


def test_a_failed_write_leaves_the_old_page(write_run: Writer, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_run()
    before = build_report(folder).read_bytes()

    def full(self: Path, target: Path) -> Path:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(EnvironmentProblem, match="No space left"):
        build_report(folder)
    assert (folder / "report.html").read_bytes() == before
    assert not [f for f in folder.iterdir() if f.name.startswith(".")]
