"""One set-up serves files and Python: the start is masked where nobody can answer, curves bring what they know."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import livlab
from livlab.api.fitting import _asked, _curve, _parameter
from livlab.config import parse_experiment
from livlab.errors import ConfigError, InputError
from livlab.fitting.forward import Response
from livlab.kinds.fit.setup import FitSetup, MeasuredCurve
from livlab.optimise import Parameter, ParameterSpace

TEXT = """
schema = 1
kind = "fit"
name = "two"
[tissue]
preset = "skin"
[tissue.set]
"layers.dermis.elements.baseline.fraction" = 0.9
[wavelengths]
list_nm = [500, 550, 600]
[[parameter]]
label = "blood"
path = "layers.dermis.elements.blood.fraction"
low = 0.002
high = 0.05
[[parameter]]
label = "clamped"
path = "layers.dermis.elements.blood.oxygenation"
low = 0.0
high = 1.0
only = ["a"]
[[measurement]]
label = "a"
dataset = "x"
sd = 0.01
[[measurement]]
label = "b"
dataset = "x"
role = "check"
[measurement.set]
"layers.dermis.elements.blood.oxygenation" = 0.9
"""
BLOOD = "layers.dermis.elements.blood"
MEASURED = np.linspace(450.0, 700.0, 26)


def setup(**curves: Any) -> FitSetup:
    config = parse_experiment(TEXT)
    made = {k: MeasuredCurve(np.asarray(v, dtype=float), None, MEASURED) for k, v in curves.items()}
    return FitSetup.of(config, made)  # type: ignore[arg-type]


def test_a_set_up_places_each_curve_in_the_scene_of_its_tissue() -> None:
    made = setup(a=[0.2, 0.3, 0.4], b=[0.3, 0.4, 0.5])
    assert [t.label for t in made.fitted] == ["a"]  # b is only looked at
    np.testing.assert_array_equal(made.targets["a"].use, [True] * 3 + [False] * 3)
    np.testing.assert_array_equal(made.targets["b"].use, [False] * 3 + [True] * 3)
    np.testing.assert_array_equal(made.targets["a"].sigma[:3], 0.01)
    assert len(made.forward.scenes) == 2
    best = {f"{BLOOD}.fraction": 0.02, f"{BLOOD}.oxygenation of a": 0.4}
    for label, oxygen in (("a", 0.4), ("b", 0.9)):
        blood = made.tissue(label, best).layers[1].elements["blood"]
        assert (blood.fraction, blood.oxygenation) == (0.02, oxygen)  # type: ignore[union-attr]
    assert setup(a=[0.2, 0.3, 0.4]).targets.keys() == {"a"}


def test_interpolated_points_do_not_count_as_measured_ones() -> None:
    config = parse_experiment(TEXT.replace("list_nm = [500, 550, 600]", "start_nm = 500\nstop_nm = 600\nstep_nm = 10"))
    grid = config.wavelengths.grid()  # type: ignore[union-attr]
    coarse = MeasuredCurve(np.linspace(0.2, 0.4, 11), None, np.array([440.0, 499.0, 503.0, 548.0, 600.0, 660.0]))
    made = FitSetup.of(config, {"a": coarse})  # type: ignore[arg-type]
    np.testing.assert_array_equal(grid[made.targets["a"].use[:11]], [500.0, 550.0, 600.0])
    assert made.targets["a"].independent == 2
    (note,) = made.notes
    assert note.startswith("a was measured at fewer wavelengths than the fit has: 3 of 11 are compared")
    fine = FitSetup.of(config, {"a": MeasuredCurve(coarse.data, None, grid)})  # type: ignore[arg-type]
    assert fine.targets["a"].size == 11
    assert fine.notes == ()
    with pytest.raises(InputError, match=r"measurement a = '1 points': must have 2 or more"):
        FitSetup.of(config, {"a": MeasuredCurve(coarse.data, None, np.array([300.0, 549.0, 800.0]))})  # type: ignore[arg-type]


def test_the_start_is_nan_where_the_last_walk_cannot_answer() -> None:
    space = ParameterSpace([Parameter("p", 0.0, 1.0, 0.25)])

    def answer(values: dict[str, float]) -> Response:
        there = np.array([True, True, values["p"] > 0.5])
        return Response(np.full(3, values["p"]), np.zeros(3), there, {})

    made = FitSetup(SimpleNamespace(), space, SimpleNamespace(answer=answer), {})  # type: ignore[arg-type]
    best, begun = made.curves(SimpleNamespace(best={"p": 0.75}, space=space))  # type: ignore[arg-type]
    np.testing.assert_array_equal(best.value, 0.75)
    np.testing.assert_array_equal(begun, [0.25, 0.25, np.nan])


def test_python_says_of_a_curve_what_a_file_says_of_a_measurement() -> None:
    known = livlab.Spectrum.of([500, 600], [0.1, 0.2], [0.01, 0.02], name="a")
    bare = livlab.Spectrum.of([500, 600], [0.1, 0.2], name="b")
    curves = {"a": known, "b": bare}
    assert _asked(None, curves, "a", "max", "rmse")["sd_column"] == "standard_error"
    assert "sd_column" not in _asked(None, curves, "b", "max", "rmse")
    own = _asked({"a": {"relative_sd": 0.05, "scaling": "sum"}}, curves, "a", "max", "chi2")
    assert own == {"label": "a", "dataset": "in-memory", "scaling": "sum", "loss": "chi2", "relative_sd": 0.05}
    with pytest.raises(InputError, match=r"names no curve.*Did you mean|names no curve") as told:
        _asked({"aa": {}}, curves, "a", "max", "rmse")
    assert "a" in told.value.remedy
    with pytest.raises(InputError, match="is the curve's own"):
        _asked({"a": {"dataset": "other"}}, curves, "a", "max", "rmse")
    found = _curve(known, np.array([450.0, 550.0, 600.0]))
    np.testing.assert_allclose(found.data, [np.nan, 0.15, 0.2])
    np.testing.assert_allclose(found.sd, [np.nan, 0.015, 0.02])  # type: ignore[arg-type]
    assert found.range_nm == (500.0, 600.0)
    assert _parameter("p", [{"low": 0, "high": 1, "only": ["a"]}, {"low": 0, "high": 1, "only": ["b"]}]) == [
        {"path": "p", "low": 0, "high": 1, "only": ["a"]},
        {"path": "p", "low": 0, "high": 1, "only": ["b"]},
    ]
    with pytest.raises(InputError, match=r"must be \(low, high\)"):
        _parameter("p", [])


def test_what_python_asks_wrongly_of_several_curves_is_refused() -> None:
    curves = {name: ([500, 600, 700], [0.1, 0.2, 0.3]) for name in ("a", "b")}
    path = f"{BLOOD}.fraction"
    with pytest.raises(ConfigError, match="names no measurement"):
        livlab.fit(curves, {path: {"low": 0.002, "high": 0.01, "only": ["c"]}}, tissue="skin")
    with pytest.raises(ConfigError, match="is a parameter of this tissue"):
        livlab.fit(curves, {path: (0.002, 0.01)}, tissue="skin", measurements={"a": {"set": {path: 0.01}}})
    with pytest.raises(ConfigError, match="none is to be fitted"):
        livlab.fit(curves, {path: (0.002, 0.01)}, tissue="skin", measurements={n: {"role": "check"} for n in curves})
    short = {"a": ([450, 500, 600], [0.1, 0.2, 0.3]), "b": ([500, 600], [0.2, 0.3])}
    with pytest.raises(InputError, match="reaches beyond the curve, 500–600 nm"):
        livlab.fit(short, {path: (0.0002, 0.001)}, tissue="skin", measurements={"b": {"band_nm": [450, 600]}})


def test_two_measured_tissues_are_fitted_at_once(libllvm: object) -> None:
    """Blood in common, oxygenation of each its own; a third curve, of a tissue set apart, is only looked at."""
    base = {"layers.dermis.elements.baseline.fraction": 0.9}
    grid = [520, 540, 560, 580, 600, 640]

    def seen(oxygenation: float) -> livlab.Spectrum:
        changes = base | {f"{BLOOD}.fraction": 0.02, f"{BLOOD}.oxygenation": oxygenation}
        return livlab.spectrum("skin", "measured", grid, changes=changes, solver="adding-doubling")

    found = livlab.fit(
        {"clamped": seen(0.2), "released": seen(0.9), "middle": seen(0.5)},
        {
            f"{BLOOD}.fraction": {"low": 0.005, "high": 0.05, "label": "blood", "transform": "log"},
            f"{BLOOD}.oxygenation": [
                {"low": 0.0, "high": 1.0, "label": "oxygen, clamped", "only": ["clamped"]},
                {"low": 0.0, "high": 1.0, "label": "oxygen, released", "only": ["released"]},
            ],
        },
        tissue="skin",
        changes=base,
        scaling="none",
        measurements={"middle": {"role": "check", "set": {f"{BLOOD}.oxygenation": 0.5}}},
        search={"standard_error": 0.004},
    )
    truth = {"blood": 0.02, "oxygen, clamped": 0.2, "oxygen, released": 0.9}
    for name, value in truth.items():
        sd = found.table.loc[name, "sd"]
        assert abs(found.values[name] - value) <= 3.0 * sd + 1e-9, name
        assert sd < 0.15
    assert found.table.loc["oxygen, clamped", "path"] == f"{BLOOD}.oxygenation"
    assert found.scores["role"].to_dict() == {"clamped": "fit", "released": "fit", "middle": "check"}
    assert found.scores.loc["middle", "rmse"] < 0.01  # not seen by the fit, and met
    oxygen = {k: t.layers[1].elements["blood"].oxygenation for k, t in found.tissues.items()}  # type: ignore[union-attr]
    assert oxygen["middle"] == 0.5
    assert oxygen["clamped"] == found.values["oxygen, clamped"] < 0.5 < oxygen["released"]
    assert found.tissue == found.tissues["clamped"]
    for name, curve in found.spectra.items():
        assert np.abs(curve.value - found.measured[name].value).max() < 0.02, name
    assert (found.spectra["clamped"].value != found.spectra["released"].value).any()
    from matplotlib.figure import Figure

    lines = found.plot(Figure().subplots()).get_lines()
    drawn = [line for line in lines if line.get_label() == "released, measured"]
    np.testing.assert_array_equal(drawn[0].get_xdata(), grid)
    assert "oxygen, released" in found._repr_html_()
