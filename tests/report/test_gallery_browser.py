"""The gallery and a picture's report in a real browser: quiet, offline, no sideways scroll, from phone to desktop."""

from __future__ import annotations

import functools
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from picture_fakes import BallCamera, small

from livlab.kinds import execute as runs
from livlab.kinds.picture import job as picture
from livlab.kinds.picture.gallery import build_gallery

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine: the page was not opened in a browser"),
]
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"]
MORE = 'readings = ["thesis", "measured"]\nbaselines = ["lambert", "dipole"]\n'


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    base = tmp_path_factory.mktemp("pictures")
    config = small(old='readings = ["thesis", "measured"]\n', new=MORE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(picture, "prepare", functools.partial(picture.prepare, make_camera=BallCamera))
        done = runs.execute(config, base=base)
    assert done.report is not None
    return {"report": done.report, "gallery": build_gallery([done.folder], base / "gallery")}


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield chromium
        chromium.close()


@pytest.mark.parametrize("what", ["report", "gallery"])
@pytest.mark.parametrize(("width", "scheme"), [(360, "dark"), (800, "light"), (1600, "dark")])
def test_pictures_fit_load_and_say_what_they_show(
    browser: Any, pages: dict[str, Path], what: str, width: int, scheme: str
) -> None:
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    said: list[str] = []
    asked: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(pages[what].as_uri())
    page.evaluate("window.scrollTo(0, document.documentElement.scrollHeight)")
    page.wait_for_function("[...document.images].every(i => i.complete)")
    assert said == []
    assert [u for u in asked if not u.startswith(("file:", "data:"))] == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    images = page.evaluate("[...document.images].map(i => [i.naturalWidth, i.getBoundingClientRect().right, i.alt])")
    assert len(images) == 4
    for natural, right, alt in images:
        assert natural == 24
        assert right <= width
        assert len(alt) > 20
    assert page.evaluate("[...document.querySelectorAll('h1')].length") == 1
    page.close()
