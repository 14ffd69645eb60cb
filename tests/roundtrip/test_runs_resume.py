"""A walk that was stopped in the middle of a reading ends as the one that was not."""

from __future__ import annotations

from pathlib import Path

import pytest
import xarray as xr

from livlab.config import parse_experiment
from livlab.errors import Interrupted
from livlab.kinds.execute import execute
from livlab.runs.files import read_csv
from livlab.runs.identity import read_manifest
from livlab.runs.work import PIECES, Silent

WALK = """\
schema = 1
kind = "spectral"
name = "walk"
readings = ["thesis", "measured"]
tissue = { variant = "parenchyma_only" }
wavelengths = { list_nm = [500, 600, 700] }
instrument = { kind = "collinear", acceptance_deg = 90.0 }
solver = { kind = "walk", samples = 20000, pilot = 5000, largest_launch = 15000 }
"""


class StopAfter(Silent):
    """Stop a reading after so many rounds of it."""

    def __init__(self, reading: str, rounds: int) -> None:
        self.reading, self.left, self.run = reading, rounds, None

    def advance(self, task: str, share: float, text: str = "") -> None:
        if task == self.reading and share > 0 and self.left > 0:
            self.left -= 1
            if not self.left:
                import os
                import signal

                os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.parametrize("reading", ["thesis", "measured"])
def test_a_stopped_walk_goes_on_and_ends_as_the_undisturbed_one(reading: str, tmp_path: Path) -> None:
    config = parse_experiment(WALK)
    whole = execute(config, base=tmp_path / "whole", report=False)
    with pytest.raises(Interrupted) as stopped:
        execute(config, base=tmp_path / "parts", report=False, progress=StopAfter(reading, 2))
    assert stopped.value.exit_code == 130
    (folder,) = (tmp_path / "parts").iterdir()
    assert read_manifest(folder)["status"] == "partial"
    for piece in (folder / PIECES).glob("*.nc"):
        with xr.open_dataset(piece, engine="h5netcdf") as kept:
            assert {"value", "diffuse_reflectance"} <= set(kept)
            assert "reflectance" not in kept  # what the instrument reads is the piece's value
    done = execute(config, base=tmp_path / "parts", report=False)
    assert not done.cached
    assert done.folder.name == whole.folder.name
    for a, b in zip(read_csv(whole.folder / "spectra.csv"), read_csv(done.folder / "spectra.csv"), strict=True):
        assert a["reading"] == b["reading"]
        assert int(a["samples"]) == int(b["samples"]) == 20000
        assert float(b["reflectance"]) == pytest.approx(float(a["reflectance"]), rel=1e-8)
        assert float(b["standard_error"]) == pytest.approx(float(a["standard_error"]), rel=1e-6)
