"""Picture experiments that do not fit, and what the user is told; files that are part of a run's identity."""

from __future__ import annotations

from pathlib import Path

import pytest
from picture_fakes import SMALL, small

from livlab.config import load_experiment, parse_experiment, to_toml
from livlab.errors import ConfigError
from livlab.kinds.picture.config import PictureExperiment
from livlab.model.shapes import box
from livlab.runs.identity import canonical

ROOT = Path(__file__).resolve().parents[4]
PICTURES = sorted((ROOT / "experiments").glob("liver-*.toml"))


def told(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        parse_experiment(text, source="a.toml")
    return f"{caught.value.message} {caught.value.remedy}"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("width = 24", "widht = 24", r"camera.widht = 24: unknown key. Did you mean 'width'?"),
        ("width = 24", "width = 0", "camera.width = 0"),
        ("width = 24", "width = 8192\nfov_deg = 180", "camera.fov_deg = 180"),
        ("position_mm = [0, -300, 0]", "position_mm = [0, 0, 0]", "target_mm"),
        ("position_mm = [0, -300, 0]", "position_mm = [0, 0, 9]", "must not lie along the view"),
        ('kind = "directional"', 'kind = "directionl"', "directionl"),
        ("towards = [0, -1, 1]", "towards = [0, 0, 0]", "must not be zero"),
        ("count = 2", "count = 0", "colour.count = 0"),
        ("kappa_nm = 20", "kappa_nm = 0", "must be > 0 for 2 wavelengths"),
        ("kappa_nm = 20", 'routes = ["thesis", "thesis"]', "appears twice"),
        ("kappa_nm = 20", 'illuminant = "D66"', "illuminant"),
        ("spp = 12", "spp = 0", "sampling.spp = 0"),
        ('readings = ["thesis", "measured"]', 'readings = ["theses"]', "Did you mean 'thesis'"),
        ('readings = ["thesis", "measured"]', "", "at least one reading"),
        ('readings = ["thesis", "measured"]', 'readings = ["thesis"]\nbaselines = ["phong"]', "baselines[0] = 'phong'"),
        ("width = 24\nheight = 16", "width = 8000\nheight = 8000", "GiB"),
    ],
)
def test_what_does_not_fit_is_told(old: str, new: str, message: str) -> None:
    assert old in SMALL
    assert message in told(SMALL.replace(old, new, 1))


CRITERION = '\n[[criterion]]\nmetric = "{metric}"\nwithin = [{low}, {high}]\n{more}\n'


@pytest.mark.parametrize(
    ("metric", "low", "high", "more", "message"),
    [
        ("hue", 20, 10, "", "must rise"),
        ("hue", 10, 20, 'reading = "mesured"', "Did you mean 'measured'"),
        ("hue difference", 10, 20, "", "needs the other side"),
        ("hue", 10, 20, 'against = "healthy"', "compares with nothing"),
        ("hue difference", 10, 20, 'against = "healthy"', "There is none to name"),
        ("colour difference", 0, 2, 'against = "cie"', "Known: thesis"),
        ("hue", 10, 20, 'route = "cie"', "route"),
        ("brightness", 10, 20, "", "brightness"),
    ],
)
def test_a_criterion_that_does_not_fit_is_told(metric: str, low: int, high: int, more: str, message: str) -> None:
    assert message in told(SMALL + CRITERION.format(metric=metric, low=low, high=high, more=more))


def test_accuracy_wants_exactly_one_rule() -> None:
    assert "exactly one" in told(SMALL + "\n[accuracy]\n")
    assert "exactly one" in told(SMALL + "\n[accuracy]\nrelative = 0.02\nseconds = 3.0\n")


def test_what_is_written_out_in_full_is_the_same_experiment() -> None:
    config = small()
    full = config.resolve()
    assert full.tissue.inline is not None
    assert [r.name for r in full.reading] == ["thesis", "measured"]
    again = parse_experiment(to_toml(full), source="config.toml")
    assert canonical(again) == canonical(config) == canonical(full)


@pytest.mark.parametrize("path", PICTURES, ids=lambda p: p.stem)
def test_every_picture_of_the_project_can_be_prepared(path: Path) -> None:
    from livlab.kinds.picture.colour import colour_routes
    from livlab.model.tissue.optics import optical_stack

    config = load_experiment(path)
    assert isinstance(config, PictureExperiment)
    grid, _ = colour_routes(config.colour, config.seed)
    tissues = [t.build() for t in config.tissues.values()]
    for tissue in tissues:
        stack = optical_stack(tissue, config.all_readings[0], grid)
        assert len(stack.wavelength_nm) == len(grid)


def test_a_mesh_is_part_of_the_identity_and_a_changed_one_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "cube.ply"
    box(10.0).as_trimesh().export(file)
    text = SMALL + f'\n[geometry]\nshape = {{ kind = "mesh", path = "{file}" }}\n'
    first = parse_experiment(text).resolve()
    before = canonical(first)
    box(11.0).as_trimesh().export(file)
    assert canonical(parse_experiment(text)) != before
    with pytest.raises(ConfigError, match="sha256"):
        first.resolve()
    file.unlink()
    with pytest.raises(ConfigError, match="cannot be read"):
        parse_experiment(text).resolve()
