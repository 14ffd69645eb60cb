"""No kernel of the tracer reads or writes outside its arrays: Dr.Jit's own checks at many wavelengths and layerings."""

import subprocess
import sys

import pytest

CHILD = """
import sys
import numpy as np
from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import READINGS
from livlab.kinds.picture.scene import nested_stack
from livlab.model.shapes import distance_field, sphere
from livlab.model.shapes.shell import inset
from livlab.model.tracer import stage
from livlab.model.tracer.body import Body
from livlab.model.tracer.tracer import Tracer
from livlab.model.tracer.variant import mitsuba

reading, variant, count, layering = sys.argv[1:]
mi = mitsuba("llvm_ad_spectral")
import drjit as dr

dr.set_flag(dr.JitFlag.Debug, True)
grid = np.linspace(460.0, 700.0, int(count))
stack = optical_stack(load_preset("liver", variant=variant), READINGS[reading], grid)
mesh = sphere(20.0, resolution_mm=2.0)
scene = {
    "type": "scene",
    "sensor": stage.sensor(mi, [0, -60, 10], [0, 0, 0], [0, 0, 1], 0.6, 16, 16),
    "body": stage.surface(mi, mesh),
    "lamp": stage.rectangle_light(mi, [-20, -50, 40], [0, 0, 0], [20, 20], 5.0),
    "point": stage.point_light([30, -50, 40], 1e3),
    "around": stage.surrounding_light(mi, 0.5),
    "wall": {"type": "sphere", "center": [25, 0, 0], "radius": 4, "bsdf": {"type": "plastic"}},
}
if layering == "nested":
    stack = nested_stack(stack)
    scene["inner"] = stage.surface(mi, inset(mesh, 0.1, "distance").mesh)
body = Body(stack, ["body"], distance_field(mesh, 0.5)) if layering == "depth" else Body(stack, ["body", "inner"])
tracer = Tracer(scene, stack.wavelength_nm, body)
total, _ = tracer.launch(2, 2, 1, 0)
assert np.isfinite(total).all() and (total > 0).any()
print("traced")
"""


@pytest.mark.parametrize(
    ("reading", "variant", "count", "layering"),
    [
        ("measured", "whole", 29, "depth"),
        pytest.param("measured", "whole", 32, "nested", marks=pytest.mark.slow),
        pytest.param("consistent", "whole", 7, "depth", marks=pytest.mark.slow),
        pytest.param("thesis", "parenchyma_only", 3, "depth", marks=pytest.mark.slow),
        pytest.param("thesis", "capsule_only", 1, "depth", marks=pytest.mark.slow),
    ],
)
def test_nothing_is_read_or_written_outside(libllvm, reading, variant, count, layering):
    command = [sys.executable, "-c", CHILD, reading, variant, str(count), layering]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.stdout.strip().endswith("traced"), done.stderr[-2000:]
    assert "out-of-bounds" not in done.stdout + done.stderr
