"""The experiment of round trips as a user runs it: fifty livers simulated by walks of their own, fitted."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from livlab.config import load_experiment
from livlab.kinds.execute import execute

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_fifty_livers_come_back(tmp_path: Path) -> None:
    # Some 200 intervals that say anything: 0.95 ± 0.03 if a tissue's four hold or fail together. Intervals of 80 %
    # (what the covariance alone gives here) would be five standard errors off.
    done = execute(load_experiment(ROOT / "experiments" / "fit-round-trip.toml"), base=tmp_path, report=False)
    claims = pd.read_csv(done.folder / "claims.csv").set_index("criterion")
    assert 0.90 <= claims.loc["coverage of round trips", "value"] <= 0.99
    table = pd.read_csv(done.folder / "round_trip.csv").set_index("parameter")
    assert (table["tissues"] == 50).all()
    # No single parameter is worse than chance allows: 42 of 50 and fewer have a chance of 0.3 % at 0.95 (2 % in one of
    # six), and of a half at 0.85. Too many is no fault: an interval that spans its box holds every truth.
    assert (table["inside"] >= 43).all()
