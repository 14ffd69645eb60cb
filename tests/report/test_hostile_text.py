"""Words from a user's file stay words on every page: nothing of them becomes an element, an attribute or a script."""

from __future__ import annotations

import json
import shutil
from html.parser import HTMLParser
from pathlib import Path

import pandas as pd
import pytest
from matplotlib.figure import Figure

from fuzz.seeds import seeds
from livlab.errors import InputError
from livlab.kinds.picture.gallery import build_gallery
from livlab.kinds.report import build_report
from livlab.reports.figures import drawn_by_livlab, svg

EVIL = (
    '"><img src=x onerror="window.hit=1;alert(1)"></title></style></script><script>window.hit=1;alert(1)</script>'
    "<svg onload=alert(1)>' onmouseover='alert(1) {{7*7}} javascript:alert(1) ]]>-->"
)

OWN = ("onsubmit", "return false")
"""The only event that a page of ours listens to by an attribute: the bench's form, which sends nothing."""


class Page(HTMLParser):
    """Elements and attributes of a page, and its words."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.events: list[str] = []
        self.words: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.events += [
            name
            for name, value in attrs
            if (name.startswith("on") and (name, value) != OWN) or (value or "").startswith("javascript:")
        ]
        self.words += [value for name, value in attrs if name in ("alt", "aria-label", "title") and value]

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def tame(text: str) -> str:
    """The words of a page that holds nothing of EVIL as markup; the number of its scripts is the house's own."""
    page = Page()
    page.feed(text)
    assert not page.events
    assert "alert(1)</script>" not in text
    assert page.tags.count("script") == text.count("data-bench")
    assert "<img src=x" not in text
    assert "<svg onload" not in text
    assert " 49 " not in text.replace("{{7*7}}", "")
    return " ".join(page.words)


def poison(folder: Path) -> Path:
    """The folder with EVIL behind the title, the description, the notes and the name, and behind cells of words."""
    config = folder / "config.toml"
    lines = [x for x in config.read_text(encoding="utf-8").splitlines() if not x.startswith(("title", "description"))]
    given = f"title = {json.dumps(EVIL)}\ndescription = {json.dumps(EVIL)}\n"
    config.write_text(given + "\n".join(lines), encoding="utf-8")
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    for key in ("name", "command", "digest", "livlab", "platform"):
        manifest[key] = f"{manifest.get(key, '')}{EVIL}"
    manifest["notes"] = [EVIL]
    manifest["packages"] = {EVIL: EVIL}
    (folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    claims = pd.read_csv(folder / "claims.csv")
    if len(claims):
        claims["criterion"] = claims["criterion"] + EVIL
        claims.to_csv(folder / "claims.csv", index=False)
    return folder


def every_text_cell(folder: Path, table: Path) -> bool:
    """Put EVIL behind every cell of words in one table; whether there was any."""
    frame = pd.read_csv(table, keep_default_na=False)
    words = [c for c in frame.columns if not pd.api.types.is_numeric_dtype(frame[c])]
    for column in words:
        frame[column] = [f"{x}{EVIL}" for x in frame[column]]
    frame.to_csv(table, index=False)
    return bool(words) and len(frame) > 0


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Run folders by kind, and a folder with one in it for the gallery."""
    base = tmp_path_factory.mktemp("kinds")
    for name in ("run", "run-picture"):
        seeds(name, base / name)
    return {"spectral": base / "run" / "folder", "picture": base / "run-picture" / "folder"}


def copied(made: dict[str, Path], kind: str, to: Path) -> Path:
    return Path(shutil.copytree(made[kind], to / kind))


@pytest.mark.parametrize("kind", ["spectral", "picture"])
def test_a_report_escapes_what_a_user_wrote(made: dict[str, Path], kind: str, tmp_path: Path) -> None:
    words = tame(build_report(poison(copied(made, kind, tmp_path))).read_text(encoding="utf-8"))
    assert words.count("window.hit=1") >= 4


def test_a_gallery_escapes_and_writes_only_under_its_folder(made: dict[str, Path], tmp_path: Path) -> None:
    folder = poison(copied(made, "picture", tmp_path))
    page = build_gallery([folder], tmp_path / "out" / "gallery")
    assert "window.hit=1" in tame(page.read_text(encoding="utf-8"))
    assert {x.parent.name for x in (tmp_path / "out").rglob("*") if x.is_file()} == {"gallery", "images"}


@pytest.mark.parametrize("name", ["../secret.png", "/etc/hostname", "link.png"])
def test_a_pictures_table_shows_no_file_from_elsewhere(made: dict[str, Path], name: str, tmp_path: Path) -> None:
    folder = copied(made, "picture", tmp_path)
    (tmp_path / "secret.png").write_bytes(b"\x89PNG\r\n\x1a\nsecret secret")
    (folder / "link.png").symlink_to(tmp_path / "secret.png")
    table = pd.read_csv(folder / "pictures.csv")
    table["png"] = name
    table.to_csv(folder / "pictures.csv", index=False)
    with pytest.raises(InputError, match="no finished picture"):
        build_gallery([folder], tmp_path / "gallery")
    assert "c2VjcmV0" not in build_report(folder).read_text(encoding="utf-8")  # "secret", as a data URL has it


def test_dollars_in_a_label_are_no_mathematics() -> None:
    figure = Figure()
    ax = figure.subplots()
    for k, label in enumerate(("costs $5 or $6", r"$\no_such_thing{$", "$", r"$\mathdefault{\x}$")):
        ax.plot([1, 2], [k, 1], label=label)
    ax.set_yticks([0, 1], [r"$\bad{$", "b"])
    ax.set_xscale("log")
    ax.set_xlabel(r"eye $\theta_o$ [deg]")
    ax.legend()
    text = svg(figure)
    assert "costs $5 or $6" in text
    assert r"$\no_such_thing{$" in text
    assert r"\theta_o" not in text.replace("<!-- eye $\\theta_o$ [deg] -->", "")


@pytest.mark.parametrize(
    "evil",
    [
        "<script>alert(1)</script>", '<g onload="alert(1)"/>', "<foreignObject/>", '<a href="javascript:alert(1)"/>',
        '<image href="https://a.b/c.png"/>', "<!DOCTYPE x>", "<set attributeName='x'/>", "<g>",
        "<!--><script>alert(1)</script>--><![CDATA[<script>alert(1)</script>]]>", "<style>@import 'a'</style>",
        "<rect style='fill: url(https://a.b)'/>",
    ],
)  # fmt: skip
def test_a_figure_from_elsewhere_goes_into_no_page(evil: str) -> None:
    start, end = '<svg xmlns="http://www.w3.org/2000/svg">', "</svg>"
    figure = Figure()
    figure.subplots().plot([1, 2], [1, 2], label="a")
    assert drawn_by_livlab('<?xml version="1.0"?>' + svg(figure)) is not None
    assert drawn_by_livlab(f"{start}<g/>{end}") is not None
    assert drawn_by_livlab(f"{start}{evil}{end}") is None
    assert drawn_by_livlab("no figure") is None


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["spectral", "picture", "optics"])
def test_every_cell_of_words_is_escaped(made: dict[str, Path], kind: str, tmp_path: Path) -> None:
    if kind == "optics":
        seeds("run-optics", tmp_path / "seed")
        made = {**made, "optics": tmp_path / "seed" / "folder"}
    shown = 0
    for table in sorted(made[kind].glob("*.csv")):
        folder = copied(made, kind, tmp_path / table.stem)
        if not every_text_cell(folder, folder / table.name):
            continue
        try:
            text = build_report(folder).read_text(encoding="utf-8")
        except InputError as error:  # words that the page looks up are no longer found
            assert "changed since it was written" in error.message or error.remedy
            continue
        shown += "window.hit=1" in tame(text)
    assert shown >= 2


@pytest.mark.browser
def test_no_dialog_opens_in_a_browser(made: dict[str, Path], tmp_path: Path) -> None:
    api = pytest.importorskip("playwright.sync_api")
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    pages = [build_report(poison(copied(made, kind, tmp_path))) for kind in made]
    pages.append(build_gallery([tmp_path / "picture"], tmp_path / "gallery"))
    with api.sync_playwright() as p:
        try:
            browser = p.chromium.launch(executable_path=found, args=["--no-sandbox", "--disable-gpu"])
        except Exception as error:
            pytest.skip(f"no headless Chromium: {str(error).splitlines()[0]}")
        opened = browser.new_page()
        faults: list[str] = []
        opened.on("dialog", lambda d: (faults.append(d.message), d.dismiss()))
        opened.on("request", lambda r: faults.append(r.url) if not r.url.startswith(("file:", "data:")) else None)
        for page in pages:
            opened.goto(page.as_uri())
            opened.mouse.move(200, 200)
            assert opened.evaluate("window.hit === undefined")
        browser.close()
    assert faults == []
