"""The documentation as a site: builds strictly, needs no network, and can be read by everybody."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, get_args

import pytest
from docs_blocks import ROOT

from livlab.model.tissue.elements import ELEMENTS

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"]
needs_browser = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium on this machine: the site was not opened in a browser"
)
OPENED = ["index.html", "physics.html", "tutorials/spectrum.html", "reference/commands.html"]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(made)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr + done.stdout
    assert "WARNING" not in done.stderr
    return made


class Loads(HTMLParser):
    """What a page fetches by itself: not what a reader may follow."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self.pictures_without_words: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {k: v or "" for k, v in attrs}
        for key in ("src", "srcset", "poster", "data"):
            self.found += [given[key]] if key in given else []
        if tag == "link" and given.get("rel") not in {"canonical", "next", "prev"}:
            self.found.append(given.get("href", ""))
        if tag == "img" and not given.get("alt", "").strip():
            self.pictures_without_words.append(given.get("src", ""))


def test_pages_fetch_nothing_from_elsewhere(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 40
    for page in pages:
        loads = Loads()
        loads.feed(page.read_text(encoding="utf-8"))
        assert len(loads.found) >= 4
        assert [x for x in loads.found if re.match(r"(?:https?:)?//", x)] == [], page.name
        assert loads.pictures_without_words == [], page.name
        for target in loads.found:
            if page.name != "404.html" and not target.startswith(("data:", "#")):
                assert (page.parent / target.split("?")[0].split("#")[0]).exists(), f"{page.name} wants {target}"


def test_styles_fetch_nothing_from_elsewhere(site: Path) -> None:
    for style in site.rglob("*.css"):
        text = style.read_text(encoding="utf-8")
        assert re.findall(r"@import|url\([\"']?(?:https?:)?//[^)]*", text) == [], style.name


def test_every_page_is_in_the_navigation(site: Path) -> None:
    index = (site / "index.html").read_text(encoding="utf-8")
    pages = {p.relative_to(site).as_posix() for p in site.rglob("*.html")} - {"404.html"}
    assert {p for p in pages if f'href="{p}"' not in index} <= {"index.html"}


def test_what_is_made_while_building_is_there(site: Path) -> None:
    commands = (site / "reference" / "commands.html").read_text(encoding="utf-8")
    for name in ("livlab run", "livlab brdf extract", "--scheduler"):
        assert name in commands
    organ = (site / "adding-an-organ.html").read_text(encoding="utf-8")
    for kind in ELEMENTS:
        name = get_args(kind.model_fields["kind"].annotation)[0]
        assert f"<code>{name}</code></h3>" in re.sub(r'<a class="headerlink".*?</a>', "", organ)
        for row in kind.parameters():
            assert f"<td><code>{row.key}</code></td>" in organ
    physics = (site / "physics.html").read_text(encoding="utf-8")
    assert physics.count('class="tex"') > 60
    assert "$" not in re.sub(r"<script.*?</script>", "", physics, flags=re.DOTALL)
    tissue = (site / "reference" / "tissue.html").read_text(encoding="utf-8")
    assert "livlab.model.tissue.particles.sphere.mie" in tissue


def test_readme_links_lead_somewhere() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)#]+)[^)]*\)", text) + re.findall(r'(?:src|href)="([^"#]+)', text)
    assert len(links) >= 8
    assert [x for x in links if not x.startswith("http") and not (ROOT / x).exists()] == []


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield chromium
        chromium.close()


@pytest.mark.browser
@needs_browser
@pytest.mark.parametrize(("width", "scheme"), [(390, "dark"), (1280, "light")])
def test_pages_are_quiet_offline_fit_and_are_accessible(browser: Any, site: Path, width: int, scheme: str) -> None:
    from axe_playwright_python.sync_playwright import Axe

    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    said: list[str] = []
    asked: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    for name in OPENED:
        page.goto((site / name).as_uri())
        assert page.evaluate("document.documentElement.scrollWidth") <= width, name
        found = Axe().run(page, options={"preload": False})  # else it fetches the styles, which a folder refuses
        assert found.violations_count == 0, f"{name}: {found.generate_report()}"
    assert said == []
    assert [u for u in asked if not u.startswith(("file:", "data:"))] == []
    page.close()


@pytest.mark.browser
@needs_browser
def test_search_finds_without_a_server(browser: Any, site: Path) -> None:
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.goto((site / "reference" / "commands.html").as_uri())
    page.locator(".md-search__input").press_sequentially("riccati")
    first = page.locator(".md-search-result__link").first
    first.wait_for(timeout=60_000)
    assert first.get_attribute("href").startswith(site.as_uri())
    page.close()
