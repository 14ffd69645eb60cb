"""Small studies as text: an endless layer of blood, cells and scatterers, which adding-doubling solves at once."""

from __future__ import annotations

HEAD = """
schema = 1
kind = "study"
name = "small"
seed = 3
"""

TISSUE = """
[tissue.inline]
name = "pulp"

[[tissue.inline.layers]]
name = "pulp"
thickness_mm = inf
index = 1.37

[tissue.inline.layers.elements.blood]
kind = "blood"
fraction = 0.03
oxygenation = 0.6
vessel_radius_um = 10.0

[tissue.inline.layers.elements.bulk]
kind = "power_law_scatterer"
a_per_cm = 10.0
b = 1.0
anisotropy = 0.9
replaces = "cells"

[tissue.inline.layers.elements.cells]
kind = "cell"
fraction = 0.8
a_um = 20.0
b_um = 30.0
anisotropy = 0.9
"""

BAND = """
[wavelengths]
start_nm = 520
stop_nm = 700
step_nm = 60

[instrument]
kind = "hyperspectral-camera"
illumination_deg = 0.0
acceptance_deg = 60.0

[solver]
kind = "adding-doubling"
tolerance = 1e-4
"""

BLOOD = """
[[factor]]
label = "blood"
path = "layers.pulp.elements.blood.fraction"
low = 0.01
high = 0.1
transform = "log"
count = 3
"""

OXYGEN = """
[[factor]]
label = "oxygen"
path = "layers.pulp.elements.blood.oxygenation"
low = 0.0
high = 1.0
count = 2
"""

READING = """
[[factor]]
label = "scatterer"
path = "reading.parenchyma_scattering"
values = ["hepatocyte", "published"]
"""

REFERENCE = """
[[reference]]
label = "human liver"
dataset = "liver_hsi_sellner2026"
column = "human_reflectance_share"
"""

MEAN = """
[[output]]
metric = "mean"
"""

RMSE = """
[[output]]
metric = "rmse"
against = "human liver"
"""


def text(method: str, *parts: str, top: str = "", tissue: str = TISSUE, band: str = BAND) -> str:
    """A study of a method from its parts; `top` stands before the first table."""
    return f'{HEAD}method = "{method}"\n{top}\n' + "\n".join((tissue, band, *parts))
