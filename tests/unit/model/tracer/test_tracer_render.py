"""How a picture is made: until an accuracy, with progress, interrupted and gone on, wavelengths together or alone."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import xarray as xr

from livlab.errors import InputError
from livlab.model.tissue.phase.functions import Isotropic
from livlab.model.tissue.stack import plain_stack
from livlab.model.tracer import render as rendering
from livlab.model.tracer import stage
from livlab.model.tracer.body import Body
from livlab.model.tracer.render import RenderProgress, render
from livlab.model.tracer.variant import mitsuba
from livlab.model.transport.accuracy import Accuracy

STACK = plain_stack([(1.4, 0.5, 2.0, 1e3, Isotropic())])
BODY = Body(STACK, "ball")
GRID = STACK.wavelength_nm


@pytest.fixture(scope="module")
def scene() -> dict[str, Any]:
    mi = mitsuba("llvm_ad_spectral")
    return {
        "type": "scene",
        "sensor": stage.sensor(mi, [0, 0, 30], [0, 0, 0], [0, 1, 0], 0.5, 8, 6),
        "ball": {"type": "sphere", "radius": 5.0},
        "light": stage.surrounding_light(mi, 1.0),
    }


@pytest.fixture
def small_launches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rendering, "LAUNCH_PATHS", 48 * 16)


def median(found: xr.Dataset, of: str) -> float:
    """Over the pixels that see the ball."""
    seen = (np.hypot(*np.meshgrid(np.arange(8) - 3.5, np.arange(6) - 2.5)) < 2.6)[..., None]
    shares = found["radiance_se"] / (found["radiance"] if of == "relative" else 1.0)
    return float(np.median(shares.to_numpy()[seen]))


@pytest.mark.usefixtures("small_launches")
def test_a_wished_relative_error_is_met_and_not_by_far(scene: dict[str, Any]) -> None:
    told: list[RenderProgress] = []
    found = render(scene, GRID, body=BODY, seed=1, accuracy=Accuracy(relative=0.05), progress=told.append)
    assert found.attrs["finished"]
    assert told[-1].error <= 0.05 < told[-2].error
    assert 0.035 < median(found, "relative") < 0.065  # of other pixels by a few: the outline's
    # Twice as exact is four times the samples; the launches are small against either.
    finer = render(scene, GRID, body=BODY, seed=1, accuracy=Accuracy(relative=0.025))
    assert 3.3 < finer.attrs["samples"] / found.attrs["samples"] < 4.7


@pytest.mark.usefixtures("small_launches")
def test_a_wished_error_in_units_of_radiance_is_met(scene: dict[str, Any]) -> None:
    found = render(scene, GRID, body=BODY, seed=1, accuracy=Accuracy(standard_error=0.01))
    assert 0.007 < median(found, "absolute") < 0.0115


@pytest.mark.usefixtures("small_launches")
def test_a_wished_time_is_kept(scene: dict[str, Any]) -> None:
    render(scene, GRID, body=BODY, spp=16)  # compiled
    told: list[RenderProgress] = []
    render(scene, GRID, body=BODY, seed=1, accuracy=Accuracy(seconds=1.0), progress=told.append)
    assert told[-1].seconds >= 1.0
    assert len(told) > 2
    assert told[-2].seconds < 1.0


@pytest.mark.usefixtures("small_launches")
def test_samples_are_the_most_that_an_accuracy_may_take(scene: dict[str, Any]) -> None:
    found = render(scene, GRID, body=BODY, spp=64, accuracy=Accuracy(relative=1e-4))
    assert found.attrs["samples"] == 64


@pytest.mark.usefixtures("small_launches")
def test_progress_tells_how_far_it_is(scene: dict[str, Any]) -> None:
    told: list[RenderProgress] = []
    seen: list[xr.Dataset] = []
    render(scene, GRID, body=BODY, spp=128, progress=told.append, preview=seen.append)
    assert [p.samples for p in told] == [16 * (k + 1) for k in range(8)]
    assert [p.done for p in told] == pytest.approx([(k + 1) / 8 for k in range(8)])
    assert all(a.seconds < b.seconds for a, b in pairwise(told))
    assert told[-1].seconds_left == 0.0
    assert told[3].seconds_left == pytest.approx(told[3].seconds)
    assert told[-1].error < told[0].error
    assert len(seen) == 8
    # It refines: the first preview is farther from the last than the one before the last.
    away = [float(np.abs(x["radiance"] - seen[-1]["radiance"]).mean()) for x in (seen[0], seen[-2])]
    assert away[1] < 0.5 * away[0]


@pytest.mark.usefixtures("small_launches")
def test_an_interrupted_picture_is_kept_and_gone_on_to_the_same_bits(scene: dict[str, Any]) -> None:
    whole = render(scene, GRID, body=BODY, spp=128, seed=7)
    states: list[xr.Dataset] = []

    def stop(p: RenderProgress) -> None:
        if p.samples >= 48:
            raise KeyboardInterrupt

    part = render(scene, GRID, body=BODY, spp=128, seed=7, progress=stop, checkpoint=states.append)
    assert not part.attrs["finished"]
    assert part.attrs["samples"] == 48
    assert np.isfinite(part["radiance_se"].to_numpy()).all()
    again = render(scene, GRID, body=BODY, spp=128, seed=7, resume=states[-1])
    assert again.attrs["finished"]
    for name in ("radiance", "radiance_se"):
        np.testing.assert_array_equal(again[name].to_numpy(), whole[name].to_numpy())


def test_ctrl_c_before_anything_is_done_is_let_through(scene: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    from livlab.model.tracer.tracer import Tracer

    def launch(*_: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(Tracer, "launch", launch)
    with pytest.raises(KeyboardInterrupt):
        render(scene, GRID, body=BODY, spp=16)


def test_wavelengths_alone_agree_with_all_together(scene: dict[str, Any]) -> None:
    grid = np.array([500.0, 550.0, 600.0])
    layers = [plain_stack([(1.4, a, b, 1e3, Isotropic())]) for a, b in ((1.0, 2.0), (0.5, 2.5), (0.1, 3.0))]
    stack = joined(layers, grid)
    body = Body(stack, "ball")
    together = render(scene, grid, body=body, spp=1024, seed=1)
    alone = render(scene, grid, body=body, spp=1024, seed=2, together=False)
    np.testing.assert_array_equal(alone["wavelength"], grid)
    error = np.hypot(*(np.sqrt((x["radiance_se"] ** 2).sum(("row", "column"))) for x in (together, alone)))
    total = together["radiance"].sum(("row", "column"))
    away = total - alone["radiance"].sum(("row", "column"))
    assert (error < 0.01 * total).all()
    assert (np.abs(away) < 4 * error).all()
    assert float(together["radiance"].std("wavelength").max()) > 0.05  # the wavelengths do differ


def joined(parts: list[Any], grid: Any) -> Any:
    """Stacks of one wavelength each as one of all."""
    from dataclasses import replace

    first = parts[0].layers[0]
    interactions = tuple(
        replace(
            x,
            rate=np.array([p.layers[0].interactions[j].rate[0] for p in parts]),
            albedo=np.array([p.layers[0].interactions[j].albedo[0] for p in parts]),
            phases=tuple(p.layers[0].interactions[j].phases[0] for p in parts),
        )
        for j, x in enumerate(first.interactions)
    )
    one = np.ones(len(parts))
    layer = replace(first, n=1.4 * one, interactions=interactions)
    return replace(parts[0], wavelength_nm=grid, layers=(layer,), n_above=one, n_below=one)


@pytest.mark.parametrize(
    ("given", "word"),
    [
        ({"spp": 0}, "spp"),
        ({"seed": -1}, "seed"),
        ({"estimator": "exact"}, "estimator"),
        ({"variant": "llvm_ad_rgb"}, "spectral"),
        ({"max_steps": 0}, "max_steps"),
        ({"sensor": 1}, "cameras"),
        ({"wavelengths_nm": [501.0]}, "stack"),
        ({"wavelengths_nm": [float("nan")]}, "wavelengths_nm"),
        ({"body": Body(STACK, "moon")}, "moon"),
        ({"scene": {"type": "scene", "ball": {"type": "potato"}}}, "Mitsuba"),
    ],
)
def test_bad_wishes_are_named(scene: dict[str, Any], given: dict[str, Any], word: str) -> None:
    wishes: dict[str, Any] = {"scene": scene, "wavelengths_nm": GRID, "body": BODY, "spp": 2, **given}
    with pytest.raises(InputError, match=word):
        render(wishes.pop("scene"), wishes.pop("wavelengths_nm"), **wishes)


def test_a_state_of_another_picture_is_refused(scene: dict[str, Any]) -> None:
    states: list[xr.Dataset] = []
    render(scene, GRID, body=BODY, spp=16, seed=1, checkpoint=states.append)
    for wishes in ({"seed": 2, "spp": 16}, {"seed": 1, "spp": 128}):
        with pytest.raises(InputError, match="resume"):
            render(scene, GRID, body=BODY, resume=states[0], **wishes)
    smaller = scene | {"sensor": stage.sensor(mitsuba("llvm_ad_spectral"), [0, 0, 30], [0, 0, 0], [0, 1, 0], 0.5, 4, 6)}
    with pytest.raises(InputError, match="resume"):
        render(smaller, GRID, body=BODY, spp=16, seed=1, resume=states[0])
    grid = np.array([500.0, 600.0])
    body = Body(joined([STACK, STACK], grid), "ball")
    with pytest.raises(InputError, match="together"):
        render(scene, grid, body=body, spp=4, together=False, resume=states[0])


def test_a_scene_loaded_anew_gives_the_same_bits_from_the_centre_of_its_body() -> None:
    from livlab.model.shapes import distance_field, sphere

    mi, ball = mitsuba("llvm_ad_spectral"), sphere(5.0, resolution_mm=4.0)
    fields = (None, distance_field(ball, 0.4))
    for field in fields:
        made = []
        for _ in range(3):
            scene = {
                "type": "scene",
                "sensor": stage.sensor(mi, [0, 0, 0], [0, 0, 1], [0, 1, 0], 1.2, 16, 16),
                "ball": stage.surface(mi, ball),
                "light": stage.surrounding_light(mi, 1.0),
                "lamp": stage.rectangle_light(mi, [10, 3, 3], [0, 0, 0], [4, 4], 6.0),
            }
            made.append(render(scene, GRID, body=Body(STACK, "ball", field), spp=32, seed=3))
        for other in made[1:]:
            np.testing.assert_array_equal(other["radiance"], made[0]["radiance"])
            np.testing.assert_array_equal(other["systematic"], made[0]["systematic"])
