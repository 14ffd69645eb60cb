"""The experiment of round trips as a user runs it: fifty livers simulated by walks of their own, fitted."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from livlab.config import load_experiment
from livlab.runs import execute

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_fifty_livers_come_back(tmp_path: Path) -> None:
    # Some 200 intervals that say anything: 0.95 ± 0.03 if a tissue's four hold or fail together. Intervals of 80 %
    # (what the covariance alone gives here) would be five standard errors off.
    done = execute(load_experiment(ROOT / "experiments" / "fit-round-trip.toml"), base=tmp_path, report=False)
    claims = pd.read_csv(done.folder / "claims.csv").set_index("criterion")
    assert 0.90 <= claims.loc["coverage of round trips", "value"] <= 0.99
    table = pd.read_csv(done.folder / "round_trip.csv").set_index("parameter")
    assert (table["tissues"] == 50).all()
    # No single parameter is worse than chance allows: 0.95 lies within its 99.9 % binomial interval.
    from livlab.study.fit_coverage import binomial

    for name, row in table.iterrows():
        low, high = binomial(int(row["inside"]), 50, level=0.999)
        assert low <= 0.95 <= max(high, 0.95) or row["spans"] > 0, name
        assert high >= 0.95, name
