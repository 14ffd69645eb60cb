"""What is of the liver alone stays with the liver: readings, notes, reports and benches of other tissues."""

from __future__ import annotations

import math
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from livlab import datasets
from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
from livlab.config import parse_experiment
from livlab.errors import ConfigError, InputError
from livlab.kinds.execute import execute
from livlab.kinds.picture.report_words import above, last_layer
from livlab.kinds.picture.scene import nested_stack
from livlab.kinds.report import build_report
from livlab.kinds.shared.tissue_tables import readings
from livlab.kinds.spectral.bench import bench_data
from livlab.model.tissue.optics import coefficients, optical_stack
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import READINGS, rows
from livlab.model.tissue.table import tissue_table

GRID = np.array([450.0, 500.0, 550.0])
SOLUTE = "layers.dermis.elements.oxyhaemoglobin"
DISSOLVED = {
    "kind": "solute",
    "concentration_umol_per_l": 20.0,
    "spectrum": {"datasets": ["haemoglobin_prahl"], "column": "hbo2"},
}


def test_a_solute_absorbs_by_beer_and_lambert() -> None:
    tissue = load_preset("skin", changes={SOLUTE: DISSOLVED})
    found = coefficients(tissue, READINGS["measured"], GRID)["absorption"].sel(layer="dermis", element="oxyhaemoglobin")
    molar = datasets.load("haemoglobin_prahl").interpolate("hbo2", GRID)  # 1/(cm M)
    np.testing.assert_allclose(found, math.log(10) * molar * 20e-6 / 10, rtol=1e-12)
    assert "haemoglobin_prahl" in tissue.layers[1].elements["oxyhaemoglobin"].dataset_names()
    table = tissue_table(tissue).query("element == 'oxyhaemoglobin'").set_index("parameter")
    assert table.loc["concentration_umol_per_l", ["value", "unit"]].tolist() == [20.0, "µmol/L"]
    assert table.loc["spectrum", "value"] == "haemoglobin_prahl"
    assert "concentration" in tissue._repr_html_()


def test_a_molar_extinction_where_an_absorption_belongs_is_told_with_the_way_out() -> None:
    pigment = {"kind": "pigment", "fraction": 0.0, "spectrum": DISSOLVED["spectrum"]}
    wrong = load_preset("skin", changes={SOLUTE: pigment})
    with pytest.raises(InputError, match="molar extinction") as caught:
        optical_stack(wrong, READINGS["measured"], GRID)
    assert 'kind = "solute"' in caught.value.remedy
    other = load_preset("skin", changes={SOLUTE: DISSOLVED | {"spectrum": {
        "datasets": ["water_segelstein1981"], "column": "absorption_per_cm"}}})  # fmt: skip
    with pytest.raises(InputError, match="mm M"):
        optical_stack(other, READINGS["measured"], GRID)
    with pytest.raises(ConfigError, match="concentration"):
        load_preset("skin", changes={SOLUTE: DISSOLVED | {"concentration_umol_per_l": -1.0}})


def test_every_row_of_the_table_bears_on_the_liver_and_the_walks_own_on_skin() -> None:
    every = set(rows()["option"])
    assert set(load_preset("liver").options()) == every
    walk = {"redirect_factor", "scattering_phase", "dipole_distance", "zero_draw"}
    assert set(load_preset("skin").options()) == walk
    whole = load_preset("liver")
    assert "fibre_density" not in whole.with_layers(("parenchyma",)).options()
    assert "hepatocyte_axes" not in whole.with_layers(("capsule",)).options()
    columns, made = readings([READINGS["measured"]], load_preset("skin"))
    assert "bears" in columns
    assert {r["option"] for r in made if r["bears"]} == walk
    assert {r["option"] for r in made} == every


@pytest.mark.parametrize("name", ["thesis", "consistent", "measured"])
def test_an_option_that_does_not_bear_on_skin_changes_nothing_of_it(name: str) -> None:
    """What is left out of skin's report is left out with reason: any other value gives the same stack."""
    from livlab.model.tissue.readings import _choices, reading

    skin = load_preset("skin")
    base = coefficients(skin, READINGS[name], GRID)
    tried = 0
    for option in set(rows()["option"]) - set(skin.options()):
        for value in _choices(option):
            other = coefficients(skin, reading(name, **{option: value}), GRID)
            assert base.identical(other.assign_attrs(base.attrs)), option
            tried += 1
    assert tried > 30


def test_notes_speak_of_what_a_tissue_has() -> None:
    told = " ".join(optical_stack(load_preset("skin"), READINGS["thesis"], GRID).notes)
    assert not re.search("fibre|cell|hepatocyte", told, re.IGNORECASE)
    told = " ".join(optical_stack(load_preset("liver"), READINGS["thesis"], GRID).notes)
    assert "Fibres" in told
    assert "Cells" in told


def test_the_report_of_skin_does_not_speak_of_the_liver(tmp_path: Path) -> None:
    text = """
schema = 1
name = "organ"
readings = ["thesis", "measured"]
tissue = { preset = "skin" }
wavelengths = { list_nm = [500, 550, 600] }
instrument = { kind = "hyperspectral-camera" }
solver = { kind = "adding-doubling" }
"""
    done = execute(parse_experiment(text), base=tmp_path, report=False)
    page = build_report(done.folder).read_text(encoding="utf-8")
    body = page[: page.index('id="rerun"')]
    plain = re.sub(r"<[^>]+>", " ", re.sub(r"<(style|script|svg).*?</\1>", " ", body, flags=re.DOTALL))
    assert not re.search("hepatocyt|parenchyma|capsule|bile|elastin", plain, re.IGNORECASE)
    assert "17 more are about fibres, cells or states that human skin does not have" in plain
    assert "redirect_factor" in plain
    assert "no reference" in plain  # and no empty axes of residuals
    assert "model − reference" not in page


def test_a_bench_moves_laws_and_solutes_and_knows_whose_layer_it_is() -> None:
    tissue = load_preset("skin", changes={SOLUTE: DISSOLVED})
    camera = HyperspectralCamera(polarisation="crossed", acceptance_deg=60.0)
    data = bench_data(tissue, READINGS["measured"], GRID, camera, standard_error=5e-3)
    assert data["layer"] == "dermis"
    sliders = {s["path"]: s for s in data["sliders"]}
    assert sliders[f"{SOLUTE}.concentration_umol_per_l"]["value"] == 20.0
    assert sliders["layers.dermis.elements.baseline.fraction"]["value"] == 0.99
    # Each part's spectrum over its slider's value is what the element absorbs.
    found = coefficients(tissue, READINGS["measured"], GRID)["absorption"].sel(layer="dermis")
    for part in data["parts"]:
        if part["kind"] == "pigment":
            value = sliders[f"{part['path']}.{part.get('key', 'fraction')}"]["value"]
            own = found.sel(element=part["path"].rsplit(".", 1)[1])
            np.testing.assert_allclose(value * np.array(part["spectrum"]), own, rtol=1e-7)
    rest = next(p for p in data["parts"] if p["kind"] == "rest")
    np.testing.assert_allclose(rest["spectrum"], 0.0, atol=1e-8)


def test_a_bench_copies_a_scatterer_that_stands_in_for_what_it_stood_in_for() -> None:
    camera = HyperspectralCamera(polarisation="crossed", acceptance_deg=60.0)
    structure = {"kind": "power_law_scatterer", "a_per_cm": 40.0, "b": 1.0, "anisotropy": 0.8}
    skin = load_preset("skin", changes={"layers.dermis.elements.structure": structure})
    law = bench_data(skin, READINGS["measured"], GRID, camera, standard_error=5e-3)["law"]
    assert law["path"] == "layers.dermis.elements.structure"
    assert law["replaces"] == ""
    liver = load_preset("liver", changes={"layers.parenchyma.thickness_mm": math.inf})
    law = bench_data(liver, READINGS["measured"], GRID, camera, standard_error=5e-3)["law"]
    assert law["replaces"] == "hepatocyte"


@pytest.mark.parametrize(("preset", "names"), [("liver", ["capsule", "parenchyma"]), ("skin", ["epidermis", "dermis"])])
def test_nested_bodies_keep_their_layers_names(preset: str, names: list[str]) -> None:
    made = nested_stack(optical_stack(load_preset(preset), READINGS["measured"], GRID))
    assert [x.name for x in made.layers] == names


@pytest.mark.parametrize(
    ("absorbing", "layers", "words"),
    [
        (["parenchyma"], ["capsule", "parenchyma"], ("the parenchyma", "the capsule")),
        (["submucosa"], ["mucosa", "submucosa"], ("the submucosa", "the mucosa")),
        (["dermis", "parenchyma"], ["epidermis", "dermis"], ("the last layer", "what lies")),
        (["fat"], ["epidermis", "dermis", "fat"], ("the fat", "what lies")),
    ],
)
def test_pictures_name_their_own_layers(absorbing: list[str], layers: list[str], words: tuple[str, str]) -> None:
    tables = {"absorption": pd.DataFrame({"layer": absorbing}), "tissue": pd.DataFrame({"layer": layers})}
    run: Any = SimpleNamespace(table=lambda name: tables[name])
    assert (last_layer(run), above(run)) == words
