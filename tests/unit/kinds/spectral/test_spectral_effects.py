"""Effects in an experiment: what the run leaves out is written down, and moves the value by less than it says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from livlab.config import parse_experiment, to_toml
from livlab.errors import ConfigError
from livlab.kinds.execute import execute
from livlab.kinds.report import build_report
from livlab.runs.files import read_csv
from livlab.runs.identity import read_manifest

CONFIG = """\
schema = 1
kind = "spectral"
name = "effects"
readings = ["measured"]
tissue = { variant = "parenchyma_only" }
wavelengths = { list_nm = [520, 560] }
instrument = { kind = "hyperspectral-camera" }
solver = { kind = "adding-doubling", tolerance = 1e-5 }
"""


def run(text: str, base: Path) -> Path:
    return execute(parse_experiment(text), base=base, report=False).folder


def value(folder: Path) -> np.ndarray:
    with xr.open_dataset(folder / "result.nc", engine="h5netcdf") as found:
        return found["reflectance"].to_numpy().copy()


def test_what_is_left_out_is_written_down_and_moves_the_value_by_less_than_the_bound(tmp_path: Path) -> None:
    full = run(CONFIG, tmp_path)
    planned = run(CONFIG + "effects = { tolerance = 0.003 }\n", tmp_path)
    assert full != planned
    assert not (full / "plan.csv").exists()
    rows = read_csv(planned / "plan.csv")
    out = [r for r in rows if r["decision"] == "dropped" and r["why"] != "together"]
    assert out
    together = next(r for r in rows if r["why"] == "together")
    moved = np.abs(value(planned) - value(full)).max()
    assert 0.0 < moved <= float(together["bound"]) <= 0.003
    assert any(f"left out {out[0]['effect']}" in n for n in read_manifest(planned)["notes"])
    page = build_report(planned).read_text(encoding="utf-8")
    assert "What was simulated" in page
    assert out[0]["effect"] in page


def test_a_forced_effect_is_left_out_whatever_it_changes(tmp_path: Path) -> None:
    full = run(CONFIG, tmp_path)
    folder = run(CONFIG + 'effects = { mode = "all", blood = "off" }\n', tmp_path)
    rows = {r["effect"]: r["decision"] for r in read_csv(folder / "plan.csv")}
    assert rows["blood"] == "forced off"
    assert (value(folder) > 1.5 * value(full)).all()


def test_a_word_stands_for_the_table_and_the_resolved_file_says_it_in_full() -> None:
    made = parse_experiment(CONFIG + 'effects = "auto"\n')
    assert "tolerance = 0.002" in to_toml(made.resolve())
    assert parse_experiment(to_toml(made.resolve())).effects == made.effects


def test_an_effect_the_scene_does_not_have_is_refused_before_anything_is_simulated(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such effect"):
        run(CONFIG + 'effects = { blod = "off" }\n', tmp_path)
