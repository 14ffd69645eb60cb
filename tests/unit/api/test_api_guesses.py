"""Who guesses how the notebook surface is called gets what was meant, or is told it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest

import livlab
from livlab.errors import LivlabError

GRID = [500.0, 600.0, 700.0]
CURVE = ([480, 550, 650, 720], [0.1, 0.2, 0.3, 0.4])
FRACTION = "layers.parenchyma.elements.blood.fraction"


def simulated(**more: Any) -> livlab.Spectrum:
    given = {"wavelengths_nm": GRID, "variant": "parenchyma_only", "solver": "adding-doubling", **more}
    return livlab.spectrum("liver", "measured", **given)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (
            lambda: simulated(wavelengths=GRID),
            "spectrum: wavelengths = [500.0, 600.0, 700.0]: is no argument. Did you mean",
        ),
        (lambda: simulated(samples=1000), "solver={'kind': 'walk', 'samples': …}"),
        (lambda: simulated(oxygenation=0.5), "go into changes={path: value}"),
        (lambda: livlab.compare(CURVE, CURVE, normalize="max"), "Did you mean 'normalise'?"),
        (lambda: livlab.compare(CURVE, CURVE, band=(500, 600)), "Did you mean 'band_nm'?"),
        (lambda: livlab.fit(CURVE, {}, bounds=1), "parameters={path: (low, high)}"),
        (lambda: livlab.run({}, output="x"), "Did you mean 'out'?"),
        (lambda: simulated(wavelengths_nm=[0.5, 0.6]), "look like micrometres"),
        (lambda: simulated(changes={"oxygenation": 0.5}), "'layers.parenchyma.elements.blood.oxygenation'?"),
        (lambda: simulated(changes={FRACTION: 1.5}), f"{FRACTION} = 1.5: must be less than or equal to 1. Give"),
        (lambda: livlab.fit(CURVE, {"blood": (0.01, 0.1)}), "'layers.parenchyma.elements.blood'?"),
        (lambda: livlab.compare(CURVE, ([1700, 1800], [1, 2])), "(480–720 nm) that second (1700–1800 nm) covers"),
        (lambda: livlab.compare(CURVE, "liver_hsi_sellner2026"), "livlab.reference('liver_hsi_sellner2026', COLUMN)"),
        (lambda: livlab.compare(CURVE, pd.Series([1.0, 2.0, 3.0])), "counts the rows and is no wavelength"),
        (
            lambda: livlab.compare(CURVE, pd.DataFrame({"nm": [500, 600], "a": [1, 2], "b": [1, 2]})),
            "more than one curve",
        ),
    ],
)
def test_what_was_meant_is_told(call: Callable[[], object], says: str) -> None:
    with pytest.raises(LivlabError) as caught:
        call()
    assert says in str(caught.value)
    assert "troubles" not in str(caught.value)
    assert ".." not in str(caught.value)


def test_an_unknown_argument_is_a_type_error_too() -> None:
    with pytest.raises(TypeError):
        livlab.compare(CURVE, CURVE, normalize="max")  # type: ignore[call-arg]


@pytest.mark.parametrize(
    "given",
    [
        np.column_stack(CURVE),
        np.array(CURVE),
        dict(zip(*CURVE, strict=True)),
        pd.Series(CURVE[1], index=CURVE[0]),
        pd.DataFrame({"R": CURVE[1]}, index=CURVE[0]),
        pd.DataFrame({"Wavelength (nm)": CURVE[0], "R (%)": [10, 20, 30, 40], "SD (%)": [1, 1, 1, 1]}),
        livlab.Spectrum.of(*CURVE).to_pandas(),
        livlab.Spectrum.of(*CURVE).to_colour(),
    ],
    ids=["columns", "rows", "dict", "series", "frame", "frame in percent", "own frame", "colour"],
)
def test_what_a_notebook_holds_is_a_spectrum(given: object) -> None:
    found = livlab.compare(livlab.Spectrum.of(*CURVE), given, normalise="none")
    assert found.rmse == pytest.approx(0.0, abs=1e-12)
    assert found.second.value.tolist() == pytest.approx(CURVE[1])


def test_a_fit_of_as_many_parameters_as_numbers_says_that_its_intervals_are_worth_nothing() -> None:
    found = livlab.fit(
        ([560, 650], [0.02, 0.2]),
        {FRACTION: (0.01, 0.1)},
        variant="parenchyma_only",
        search={"starts": 1, "max_evaluations": 40, "standard_error": 0.02},
    )
    assert any("1 parameters are free and 1 independent numbers are compared" in note for note in found.notes)
