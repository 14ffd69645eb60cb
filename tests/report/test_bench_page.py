"""The bench in a browser: sliders are moved, and the numbers of the page are those of Python."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from livlab.acquire.instruments.collinear import Collinear
from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
from livlab.errors import InputError
from livlab.fitting.forward import LedgerForward
from livlab.kinds.spectral.bench import bench_data, bench_grid
from livlab.metrics import pearson, rmse
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import READINGS
from livlab.model.tissue.tissue import override
from livlab.reports.bench import bench_page, read_bench, write_bench

GRID = np.array([450.0, 500.0, 550.0, 600.0, 650.0, 700.0])
CAMERA = HyperspectralCamera(polarisation="crossed", acceptance_deg=60.0)
BLOOD = "layers.parenchyma.elements.blood"
REFERENCE = [0.3, 0.25, 0.2, 0.5, 0.9, None]


@pytest.fixture(scope="module")
def tissue() -> Any:
    return load_preset("liver", changes={f"{BLOOD}.oxygenation": 0.6, "layers.parenchyma.thickness_mm": float("inf")})


@pytest.fixture(scope="module")
def data(tissue: Any) -> dict[str, Any]:
    known = [{"label": "a <b> & c", "value": REFERENCE, "absolute": False}]
    return bench_data(tissue, READINGS["measured"], GRID, CAMERA, references=known, standard_error=3e-3)


@pytest.fixture(scope="module")
def forward(tissue: Any, data: dict[str, Any]) -> LedgerForward:
    """Another walk with the same draws: what the page should answer."""
    from livlab.kinds.spectral import bench

    made = LedgerForward(tissue, READINGS["measured"], GRID, CAMERA, (), standard_error=3e-3)
    stack = made.stack({})
    made.record_stacks(stack, [bench._with_absorption(made, stack, bench.WHITER * stack.layers[-1].absorption)], seed=1)
    return made


@pytest.fixture(scope="module")
def page(data: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api")
    file = write_bench(data, tmp_path_factory.mktemp("bench") / "bench.html")
    with playwright.sync_playwright() as p:
        browser = launch(p)
        context = browser.new_context(viewport={"width": 1280, "height": 900})
        opened = context.new_page()
        faults: list[str] = []
        opened.on("pageerror", lambda error: faults.append(str(error)))
        opened.on("request", lambda r: faults.append(r.url) if not r.url.startswith(("file:", "data:")) else None)
        opened.goto(file.as_uri())
        yield opened
        assert faults == []
        browser.close()


def launch(p: Any) -> Any:
    """Chromium as the machine has it, or a skip that says so."""
    import shutil

    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    options: dict[str, Any] = {"args": ["--no-sandbox", "--disable-gpu"]}
    try:
        return p.chromium.launch(**({"executable_path": found} if found else {}), **options)
    except Exception as error:
        pytest.skip(f"no headless Chromium: {str(error).splitlines()[0]}")


def python_values(forward: LedgerForward, tissue: Any, config: str) -> Any:
    """What the ledger answers for the values that the page copied."""
    from livlab.model.tissue.optics import optical_stack

    changes = tomllib.loads(config)["tissue"]["set"]
    stack = optical_stack(override(tissue, changes), READINGS["measured"], GRID)
    return forward.answer_stack(stack)


def move(page: Any, path: str, place: int) -> dict[str, Any]:
    """Move a slider as a user does, and read what the page then holds."""
    page.locator(f"input[data-path='{path}']").evaluate(
        "(e, v) => { e.value = v; e.dispatchEvent(new Event('input', { bubbles: true })); }", place
    )
    return state(page)


def state(page: Any) -> dict[str, Any]:
    return dict(page.evaluate("document.querySelector('[data-bench]').bench"))


@pytest.mark.browser
def test_moved_sliders_give_pythons_numbers(page: Any, forward: LedgerForward, tissue: Any) -> None:
    moves = [(f"{BLOOD}.fraction", 500), (f"{BLOOD}.oxygenation", 900), (f"{BLOOD}.vessel_radius_um", 300),
             ("layers.parenchyma.elements.bile.fraction", 650),
             ("layers.parenchyma.elements.lipid_and_water.parts.lipid.share", 400),
             ("scattering.factor", 620), ("scattering.exponent", 350)]  # fmt: skip
    before = state(page)["values"]
    for path, place in moves:
        now = move(page, path, place)
        assert np.abs(np.subtract(now["values"], before)).max() > 1e-5, path
        before = now["values"]
        found = python_values(forward, tissue, now["config"])
        good = np.array(now["valid"])
        assert good.all() or path != moves[0][0]
        np.testing.assert_allclose(np.array(now["values"])[good], found.value[good], rtol=0, atol=1e-4)
        np.testing.assert_allclose(np.array(now["errors"])[good], found.standard_error[good], rtol=0.1, atol=1e-6)
        assert now["milliseconds"] < 50.0
    page.locator(".bench-reset").click()
    assert state(page)["parameters"][f"{BLOOD}.oxygenation"] == 0.6


@pytest.mark.browser
def test_scores_are_those_of_the_metrics(page: Any) -> None:
    page.locator(".bench-reset").click()
    values = np.array(state(page)["values"])[:5]
    reference = np.array(REFERENCE[:5], dtype=float)
    cells = page.locator(".bench-scores td").all_inner_texts()
    assert float(cells[0]) == pytest.approx(rmse(values / values.max(), reference / reference.max()), abs=6e-5)
    assert float(cells[1]) == pytest.approx(pearson(values, reference), abs=6e-5)
    assert page.locator(".bench-scores th").inner_text() == "a <b> & c"


@pytest.mark.browser
def test_the_colour_is_that_of_the_cie_route(page: Any, data: dict[str, Any]) -> None:
    from livlab.model.colour import encode_srgb

    page.locator(".bench-reset").click()
    found = state(page)
    linear = np.array(data["colour"]) @ np.array(found["values"])
    assert found["rgb"] == np.round(255 * np.asarray(encode_srgb(np.clip(linear, 0, 1)))).astype(int).tolist()


@pytest.mark.browser
def test_where_the_walk_cannot_answer_it_says_so(page: Any) -> None:
    page.locator(".bench-reset").click()
    assert page.locator(".bench-note").is_hidden()
    for path in (f"{BLOOD}.fraction", "layers.parenchyma.elements.bile.fraction"):
        now = move(page, path, 0)
    now = move(page, "scattering.factor", 1000)
    assert not all(now["valid"])
    assert "record anew" in page.locator(".bench-note").inner_text()
    assert page.locator(".bench-plot .outside").count() == now["valid"].count(False)
    page.locator(".bench-reset").click()
    move(page, f"{BLOOD}.fraction", 1000)
    move(page, "layers.parenchyma.elements.lipid_and_water.fraction", 1000)
    assert "no such tissue" in page.locator(".bench-note").inner_text()
    page.locator(".bench-reset").click()


@pytest.mark.browser
def test_keyboard_and_labels(page: Any) -> None:
    slider = page.get_by_label("oxygenation")
    before = state(page)["parameters"][f"{BLOOD}.oxygenation"]
    slider.focus()
    slider.press("ArrowRight")
    assert state(page)["parameters"][f"{BLOOD}.oxygenation"] > before
    unnamed = page.evaluate("[...document.querySelectorAll('input, select')].filter(e => !e.labels.length).length")
    assert unnamed == 0
    assert page.locator("svg.bench-plot").get_attribute("aria-label")


@pytest.mark.browser
@pytest.mark.parametrize("width", [320, 390, 1280])
def test_nothing_sticks_out(page: Any, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_the_table_is_the_ledger_between_its_nodes(data: dict[str, Any], forward: LedgerForward) -> None:
    from livlab.kinds.spectral import bench

    table, stack = data["table"], forward.stack({})
    low, high = np.array(table["low"]), np.array(table["high"])
    reduced = np.array(data["scattering_per_mm"])
    n = table["nodes"]
    for j in (12, 20, 28):  # half-way between nodes, where a cubic is worst
        t = (j + 0.5) / (n - 1)
        wanted = forward.answer_stack(bench._with_absorption(forward, stack, np.exp(low + t * (high - low)) * reduced))
        h = (high - low) / (n - 1)
        y, m = np.array(table["value"]), np.array(table["slope"])
        cubic = 0.5 * (y[:, j] + y[:, j + 1]) + h / 8 * (m[:, j] - m[:, j + 1])
        ok = wanted.valid
        assert ok.any()
        np.testing.assert_allclose(cubic[ok], wanted.value[ok], rtol=0, atol=2e-5)


def test_text_from_a_file_cannot_become_markup(data: dict[str, Any]) -> None:
    hostile = {**data, "title": "</script><script>x</script>", "reading": "<img src=x>"}
    hostile["references"] = [{"label": "</script><b>", "value": REFERENCE, "absolute": False}]
    text = bench_page(hostile)
    assert "<script>x" not in text
    assert "<img" not in text
    assert "</script><b>" not in text


def test_a_damaged_bench_is_refused(tmp_path: Path, data: dict[str, Any]) -> None:
    assert read_bench(tmp_path) is None
    (tmp_path / "bench.json").write_text(json.dumps({**data, "version": 9}))
    with pytest.raises(InputError, match=r"bench\.json"):
        read_bench(tmp_path)
    (tmp_path / "bench.json").write_text("{")
    with pytest.raises(InputError, match=r"bench\.json"):
        read_bench(tmp_path)


def test_a_sample_with_sides_keeps_its_scattering(tissue: Any) -> None:
    thick = override(tissue, {"layers.parenchyma.thickness_mm": 140.0})
    made = bench_data(thick, READINGS["measured"], GRID[1::2], Collinear(), standard_error=1e-2)
    assert not made["endless"]
    assert not [s for s in made["sliders"] if s["path"].startswith("scattering.")]
    assert np.isfinite(made["table"]["value"]).all()


@pytest.fixture(scope="module")
def resting() -> tuple[Any, dict[str, Any]]:
    """Dermis alone, whose bloodless part takes the rest."""
    changes = {"layers.dermis.rest": "baseline"}
    tissue = load_preset("skin", variant="dermis_only", changes=changes)
    return tissue, bench_data(tissue, READINGS["measured"], GRID, CAMERA, standard_error=1e-2)


def test_what_takes_the_rest_has_no_slider(resting: tuple[Any, dict[str, Any]]) -> None:
    _, data = resting
    path = "layers.dermis.elements.baseline.fraction"
    blood = "layers.dermis.elements.blood.fraction"
    assert data["rest"] == {"path": path, "others": [blood], "fixed": 0.0}
    assert path not in [s["path"] for s in data["sliders"]]


@pytest.mark.browser
def test_the_rest_follows_the_sliders(page: Any, resting: tuple[Any, dict[str, Any]], tmp_path: Path) -> None:
    tissue, data = resting
    opened = page.context.new_page()
    opened.goto(write_bench(data, tmp_path / "bench.html").as_uri())
    now = move(opened, "layers.dermis.elements.blood.fraction", 700)
    opened.close()
    changed = override(tissue, tomllib.loads(now["config"])["tissue"]["set"])
    own = changed.layers[0].elements
    rest = now["parameters"]["layers.dermis.elements.baseline.fraction"]
    assert rest == pytest.approx(own["baseline"].share, rel=1e-6)
    assert own["blood"].share > 0.02


def test_a_grid_that_draws_a_curve() -> None:
    assert bench_grid(np.array([500.0, 720.0])).tolist() == list(np.linspace(500, 720, 23))
    assert bench_grid(np.array([500.0, 505.0])).tolist() == [500.0, 505.0]
    assert len(bench_grid(np.linspace(400, 900, 5001))) == 201
