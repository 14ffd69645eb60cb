"""The notebook's surface: what is loaded when, what is accepted, what is refused, and what a browser is given."""

from __future__ import annotations

import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import livlab
from livlab.api.claims import Claims
from livlab.api.running import plain
from livlab.api.sources import as_spectrum
from livlab.core import markup
from livlab.criteria import Claim
from livlab.errors import ConfigError, DatasetError, InputError, RangeError

HEAVY = ("numpy", "pandas", "xarray", "scipy", "pydantic", "matplotlib", "mitsuba", "drjit", "numba", "colour", "typer")
NASTY = "<script>alert('x')</script>&\""


def loaded(statement: str) -> set[str]:
    code = f"{statement}\nimport sys\nprint(*sorted({{m.partition('.')[0] for m in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


class Page(HTMLParser):
    """Tags that were opened, and whether each was closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.open: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.tags.add(tag)
        self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: object) -> None:
        self.tags.add(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_importing_livlab_loads_nothing_that_computes() -> None:
    found = loaded("import livlab\nassert 'spectrum' in dir(livlab)")
    assert "livlab" in found
    assert sorted(found & set(HEAVY)) == []
    # The same for each name alone: what a notebook does not use, it does not load.
    assert sorted(loaded("import livlab\nlivlab.run") & {"mitsuba", "drjit", "matplotlib", "numba", "scipy"}) == []
    assert sorted(loaded("import livlab\nlivlab.brdf.extract") & {"mitsuba", "drjit", "matplotlib", "cv2"}) == []


def test_importing_livlab_takes_less_than_half_a_second() -> None:
    """The best of a few: another process on the same machine must not fail it."""
    code = "import time; t = time.process_time(); import livlab; print(time.process_time() - t)"
    times = [
        float(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout)
        for _ in range(3)
    ]
    assert min(times) < 0.5


def test_every_name_is_there_and_an_unknown_one_is_an_attribute_error() -> None:
    for name in livlab.__all__:
        assert getattr(livlab, name) is not None
    for name in livlab.brdf.__all__:
        assert callable(getattr(livlab.brdf, name))
    with pytest.raises(AttributeError, match="no attribute 'spectra'"):
        _ = livlab.spectra  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match="no attribute 'render'"):
        _ = livlab.brdf.render  # type: ignore[attr-defined]


def test_a_spectrum_comes_from_what_a_notebook_holds(tmp_path: Path) -> None:
    x, y = [500.0, 600.0, 700.0], [0.1, 0.2, 0.4]
    path = tmp_path / "meu fígado.csv"
    path.write_text("Wellenlänge (nm);Reflexion (%)\n500;10,0\n600;20,0\n700;40,0\n", encoding="utf-8")
    series = pd.Series(y, index=x, name="mine")
    given = [(x, y), [x, y], series, series.to_frame("value"), path, str(path)]
    given += [livlab.Spectrum.of(x, y).to_colour()]
    for one in given:
        found = as_spectrum(one)
        np.testing.assert_allclose(found.wavelength_nm, x)
        np.testing.assert_allclose(found.value, y)
        assert np.isnan(found.standard_error).all()
    assert as_spectrum(path).name == "meu fígado"
    assert as_spectrum((x, y, [0.01] * 3)).standard_error.tolist() == [0.01] * 3


def test_a_spectrum_goes_out_and_comes_back(tmp_path: Path) -> None:
    own = livlab.Spectrum.of([500, 600.5, 700], [0.1, 0.25, 1 / 3], [0.001, 0.002, 0.003], name="mine")
    again = livlab.read_spectrum(own.to_csv(tmp_path / "ação.csv"), name="mine")
    np.testing.assert_allclose(again.value, own.value, rtol=1e-8)
    np.testing.assert_allclose(again.standard_error, own.standard_error)
    frame = own.to_pandas()
    assert frame.index.name == "wavelength_nm"
    assert livlab.Spectrum.from_pandas(frame).to_pandas().equals(frame)
    data = own.to_xarray()
    assert data["wavelength"].attrs["units"] == "nm"
    assert data["value"].to_numpy().tolist() == own.value.tolist()
    back = livlab.Spectrum.from_colour(own.to_colour())
    assert (back.name, back.value.tolist()) == ("mine", own.value.tolist())


@pytest.mark.filterwarnings("ignore::colour.utilities.ColourRuntimeWarning")
def test_colour_science_takes_a_spectrum_over() -> None:
    """The colour that colour-science makes of the distribution is the one that livlab says (another interpolation)."""
    from livlab.model.colour.science import colour_science

    colour = colour_science()
    grid = np.arange(380.0, 781.0, 5.0)
    own = livlab.Spectrum.of(grid, 0.2 + 0.3 / (1 + np.exp(-(grid - 590) / 12)))
    xyz = colour.sd_to_XYZ(own.to_colour(), illuminant=colour.SDS_ILLUMINANTS["D65"]) / 100
    expected = colour.XYZ_to_sRGB(xyz)
    np.testing.assert_allclose(own.srgb(), expected, atol=2e-3)
    assert own.srgb()[0] > own.srgb()[2]


@pytest.mark.parametrize(
    ("x", "y", "error", "said"),
    [
        ([500, 400], [1, 2], None, "wavelength_nm"),
        ([500, 600], [1], None, "value"),
        ([500, 600], [1, np.nan], None, r"value\[1\]"),
        ([500, 600], [1, 2], -0.1, "standard_error"),
        ([500, 600], ["a", "b"], None, "value"),
        ([], [], None, "wavelength_nm"),
    ],
)
def test_what_is_no_spectrum_is_refused(x: object, y: object, error: object, said: str) -> None:
    with pytest.raises(InputError, match=said):
        livlab.Spectrum.of(x, y, error)  # type: ignore[arg-type]


def test_a_spectrum_cannot_be_changed_under_its_holder() -> None:
    x, y = np.array([500.0, 600.0]), np.array([1.0, 2.0])
    own = livlab.Spectrum.of(x, y)
    y[0] = 9.0
    assert own.value[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        own.value[0] = 3.0
    with pytest.raises(RangeError, match="covers 500–600 nm"):
        own.at([601])
    with pytest.raises(InputError, match="holds no wavelength"):
        own.between(501, 502)


def test_a_comparison_is_that_of_the_metrics() -> None:
    from livlab.metrics import pearson, rmse

    a = livlab.Spectrum.of([500, 550, 600, 650], [0.1, 0.2, 0.3, 0.5], 0.001, name="a")
    b = livlab.Spectrum.of([450, 700], [0.1, 0.6], 0.002, name="b")
    found = livlab.compare(a, b, normalise="max")
    at = b.at(a.wavelength_nm)
    assert found.rmse == pytest.approx(rmse(a.value / 0.5, at / at.max()))
    assert found.pearson == pytest.approx(pearson(a.value, at))
    assert found.unknown_error == ()
    assert found.metrics["rmse"].standard_error > 0
    assert list(found.to_pandas().index) == ["rmse", "mse", "pearson", "amplitude ratio"]
    assert found.delta_e is None  # 500–650 nm leave out what the eye sees
    flat = livlab.compare(a, ([500, 650], [0.3, 0.3]), normalise="none", band_nm=(540, 660))
    assert "pearson" not in flat.metrics
    assert np.isnan(flat.pearson)
    assert flat.unknown_error == ("second",)
    assert len(flat.first) == 3
    with pytest.raises(InputError, match="leaves 0 wavelengths"):
        livlab.compare(a, ([700, 800], [1, 2]))
    same = livlab.compare(*[(np.arange(400, 701, 10), np.linspace(0.1, 0.5, 31))] * 2)
    assert same.delta_e == pytest.approx(0.0, abs=1e-9)
    assert same.rmse == 0.0


def test_claims_are_a_table() -> None:
    claims = Claims([Claim.of("rmse a vs b", 0.01, 0.001, 0.0, 0.1), Claim.missing("pearson a vs c", "no table")])
    assert repr(claims) == "<2 claims: 1 PASS, 1 MISSING>"
    frame = claims.to_pandas()
    assert frame.loc["pearson a vs c", "note"] == "no table"
    assert claims[0].verdict == "PASS"
    with pytest.raises(InputError, match="none of this run") as told:
        claims.of("rmse a vs c")
    assert "rmse a vs b" in told.value.remedy


def test_html_escapes_what_came_from_a_file() -> None:
    spectrum = livlab.Spectrum.of([500, 600], [0.1, 0.2], name=NASTY)
    tissue = livlab.tissue("skin").model_copy(update={"name": NASTY, "description": NASTY, "state": NASTY})
    layer = tissue.layers[0]
    worse = layer.elements["melanosomes"].model_copy(update={"sources": {"fraction": NASTY}})
    tissue = tissue.model_copy(
        update={"layers": (layer.model_copy(update={"name": NASTY, "elements": {NASTY: worse}}), *tissue.layers[1:])}
    )
    claims = Claims([Claim.missing(NASTY, NASTY)])
    shown = [spectrum, tissue, claims, livlab.compare(spectrum, ([500, 600], [0.1, 0.3]))]
    for one in shown:
        text = one._repr_html_()  # type: ignore[attr-defined]
        page = Page(text)
        assert page.open == []
        assert "script" not in page.tags
        assert "&lt;script&gt;" in text
        assert NASTY not in text
    assert "<b style" in markup.table(["a"], [["PASS"]])


def test_a_long_table_is_cut_and_says_so() -> None:
    text = markup.table(["n"], [[k] for k in range(100)], most=60)
    assert text.count("<tr>") == 61
    assert "and 40 more rows" in text
    assert markup.curve([1.0], [2.0], "one") == ""
    assert "nan" not in markup.curve([1.0, 2.0, 3.0], [float("nan"), 2.0, 3.0], "a")


def test_plots_return_the_axes_they_were_given() -> None:
    from matplotlib.figure import Figure

    ax = Figure().subplots()
    own = livlab.Spectrum.of([500, 600], [0.1, 0.2], 0.01, name="mine")
    assert own.plot(ax, color="red") is ax
    assert len(ax.lines) == 1
    assert len(ax.collections) == 1
    other = Figure().subplots()
    assert livlab.compare(own, ([500, 600], [1, 3])).plot(other) is other
    assert [t.get_text() for t in other.get_legend().get_texts()] == ["second", "mine"]
    new = own.plot()
    assert new is not ax
    assert new.get_xlabel() == "wavelength [nm]"
    import matplotlib.pyplot as plt

    plt.close("all")


def test_errors_name_field_value_bound_and_remedy(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="preset = 'livr'") as told:
        livlab.tissue("livr")
    assert "liver" in told.value.remedy
    with pytest.raises(InputError, match="belongs to a preset"):
        livlab.tissue(livlab.tissue("liver"), state="in_vivo")
    with pytest.raises(ConfigError, match="readings"):
        livlab.spectrum("skin", "thesys", [500, 600])
    with pytest.raises(InputError, match="must be numbers"):
        livlab.spectrum("skin", wavelengths_nm="green")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="accuracy"):
        livlab.spectrum("skin", wavelengths_nm=[500], solver="adding-doubling", accuracy=0.01)
    with pytest.raises(InputError, match="accuracy = True"):
        livlab.spectrum("skin", wavelengths_nm=[500], accuracy=True)
    with pytest.raises(InputError, match="needs its kind"):
        livlab.spectrum("skin", wavelengths_nm=[500], instrument={"distance_mm": 1.0})
    with pytest.raises(RangeError, match="haemoglobin_prahl covers 250 to 1000 nm"):
        livlab.spectrum("skin", wavelengths_nm=[1200.0], solver="adding-doubling")
    with pytest.raises(DatasetError, match="no dataset"):
        livlab.reference("nowhere")
    with pytest.raises(InputError, match="is no spectrum"):
        livlab.compare(3, 4)
    with pytest.raises(InputError, match="bounds"):
        livlab.fit(([500, 600], [1, 2]), {"a.b": 3})  # type: ignore[dict-item]
    with pytest.raises(InputError, match="must be bounds by path"):
        livlab.fit(([500, 600], [1, 2]), {})
    with pytest.raises(InputError, match="is no experiment"):
        livlab.run(3)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=r"livlab\.run: kind = 'spectrl'"):
        livlab.run({"name": "a", "kind": "spectrl"}, out=tmp_path)
    with pytest.raises(InputError, match=r"has no manifest\.json"):
        livlab.open_run(tmp_path)
    with pytest.raises(InputError, match="is neither a folder nor images"):
        livlab.brdf.extract(3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="is no rig file"):
        livlab.brdf.extract(tmp_path)
    with pytest.raises(InputError, match=r"stands in the folder's rig\.toml"):
        livlab.brdf.extract(tmp_path, sphere=object())  # type: ignore[arg-type]


def test_a_table_of_numpys_numbers_becomes_plain() -> None:
    made = plain({"a": np.float64(1.5), "b": np.arange(3), "c": (np.int64(2), Path("x")), "d": {"e": True}})
    assert made == {"a": 1.5, "b": [0, 1, 2], "c": [2, "x"], "d": {"e": True}}
    assert type(made["a"]) is float


def test_claims_are_told_apart_by_verdict_and_group() -> None:
    claims = Claims(
        [
            Claim.of("rmse a vs human liver", 0.099, 0.001, 0.0, 0.1),
            Claim.of("rmse b vs human liver", 0.09, 0.001, 0.0, 0.1),
            Claim.of("rmse c vs human liver", 0.3, 0.001, 0.19, 0.04),
            Claim.missing("energy residual", "no account", reference=0.0, tolerance=0.1),
        ]
    )
    assert repr(claims) == "<4 claims: 1 PASS, 1 FAIL, 1 TOO CLOSE, 1 MISSING>"
    assert [c.criterion[5] for c in (*claims.passed, *claims.failed, *claims.too_close)] == ["b", "c", "a"]
    assert claims.too_close[0].needs > 1
    assert len(claims.missing) == 1
    assert [len(claims.group(g)) for g in ("reproduces", "agrees", "checks")] == [1, 2, 1]
    with pytest.raises(InputError, match="group"):
        claims.group("thesis")  # type: ignore[arg-type]
    shown = claims._repr_html_()
    for heading in (
        "Reproduces the thesis",
        "Agrees with measured liver",
        "Livlab&#x27;s own checks",
    ):
        assert heading in shown
    assert shown.index("Reproduces") < shown.index("Agrees") < shown.index("own checks")
    assert "color:#2a6fc4>TOO CLOSE" in shown
    assert list(claims.to_pandas().columns[-5:]) == ["group", "at_least", "at_most", "needs", "note"]
