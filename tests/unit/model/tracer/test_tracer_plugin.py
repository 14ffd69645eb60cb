"""The plugin in scenes written as dict and as XML: the tracer's own numbers, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import READINGS
from livlab.model.tracer.body import Body
from livlab.model.tracer.plugin import register
from livlab.model.tracer.render import render

WAVELENGTHS = [500.0, 600.0, 700.0]


@pytest.fixture(scope="module")
def mi() -> Any:
    return register()


def scene(mi: Any, **settings: Any) -> dict[str, Any]:
    t = mi.ScalarTransform4f
    return {
        "type": "scene",
        "integrator": {
            "type": "livlab_walk",
            "surfaces": "ball",
            "part": "parenchyma_only",
            "wavelengths": "500,600,700",
            **settings,
        },
        "ball": {"type": "sphere", "radius": 30.0, "bsdf": {"type": "diffuse"}},
        "sensor": {
            "type": "perspective",
            "fov": 30.0,
            "to_world": t().look_at(origin=[0, 0, 200], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 6, "height": 5, "rfilter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": 64},
        },
        "light": {"type": "constant", "radiance": {"type": "spectrum", "value": 1.0}},
    }


def test_a_dict_scene_is_rendered_by_the_tracer(mi: Any) -> None:
    described = scene(mi, reading="thesis", errors=True)
    found = np.array(mi.render(mi.load_dict(described, optimize=False), seed=4))
    stack = optical_stack(load_preset("liver", variant="parenchyma_only"), READINGS["thesis"], WAVELENGTHS)
    plain = {k: v for k, v in described.items() if k != "integrator"}
    wanted = render(plain, WAVELENGTHS, body=Body(stack, "ball"), spp=64, seed=4)
    assert found.shape == (5, 6, 6)
    np.testing.assert_array_equal(found[..., :3], wanted["radiance"].to_numpy().astype(np.float32))
    np.testing.assert_array_equal(found[..., 3:], wanted["radiance_se"].to_numpy().astype(np.float32))


def test_an_xml_scene_names_it(mi: Any, tmp_path: Path) -> None:
    file = tmp_path / "scene.xml"
    file.write_text(
        """<scene version="3.0.0">
          <integrator type="livlab_walk">
            <string name="surfaces" value="ball"/><string name="part" value="parenchyma_only"/>
            <string name="reading" value="thesis"/><string name="wavelengths" value="500 600 700"/>
          </integrator>
          <shape type="sphere" id="ball"><float name="radius" value="30"/><bsdf type="diffuse"/></shape>
          <sensor type="perspective"><float name="fov" value="30"/>
            <transform name="to_world"><lookat origin="0, 0, 200" target="0, 0, 0" up="0, 1, 0"/></transform>
            <film type="hdrfilm"><integer name="width" value="6"/><integer name="height" value="5"/>
              <rfilter type="box"/></film>
            <sampler type="independent"><integer name="sample_count" value="64"/></sampler>
          </sensor>
          <emitter type="constant"><spectrum name="radiance" value="1.0"/></emitter>
        </scene>"""
    )
    from_xml = np.array(mi.render(mi.load_file(str(file), optimize=False), seed=4))
    from_dict = np.array(mi.render(mi.load_dict(scene(mi, reading="thesis"), optimize=False), seed=4))
    np.testing.assert_array_equal(from_xml, from_dict)


def test_samples_asked_of_render_rule_and_colour_is_offered(mi: Any) -> None:
    loaded = mi.load_dict(scene(mi, channels="rgb", wavelengths="450,500,550,600,650,700"), optimize=False)
    few, many = (np.array(mi.render(loaded, spp=s, seed=1)) for s in (16, 64))
    assert few.shape == many.shape == (5, 6, 3)
    assert not np.array_equal(few, many)
    middle = many[2, 3]
    assert middle[0] > middle[2]  # liver is redder than it is blue


def test_planned_effects_come_from_the_planner(mi: Any) -> None:
    asked: list[float] = []

    def planner(stack: Any, tolerance: float) -> Any:
        asked.append(tolerance)
        return stack

    loaded = mi.load_dict(scene(mi, effects="planned", tolerance=0.01, reading="thesis"), optimize=False)
    register(planner=planner)
    mi.render(loaded, spp=4)
    assert asked == [pytest.approx(0.01)]


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"surfaces": ""}, "must name the shapes"),
        ({"surfases": "ball"}, "surfaces"),
        ({"wavelengths": "600,500"}, "rising"),
        ({"wavelengths": "red"}, "rising"),
        ({"channels": "xyz"}, "one of"),
        ({"reading": "guessed"}, "thesis"),
        ({"part": "whole"}, "must be a mesh"),
        ({"surfaces": "moon"}, "moon"),
    ],
)
def test_bad_settings_are_named(mi: Any, settings: dict[str, Any], word: str) -> None:
    with pytest.raises(Exception) as caught:
        mi.render(mi.load_dict(scene(mi, **settings), optimize=False), spp=1)
    # What goes wrong while Mitsuba renders arrives as the cause of its own error.
    told, error = "", caught.value
    while error is not None:
        told += f"{error}\n"
        error = error.__cause__ or error.__context__  # type: ignore[assignment]
    assert word in told
