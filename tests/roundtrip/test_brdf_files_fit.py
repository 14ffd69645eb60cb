"""A fit's JSON is exported as the model that it is: the same values come back from every format, and from Mitsuba."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import livlab
from livlab.brdf.angles import direction, half_angles
from livlab.brdf.files.fitted import Fitted, read_fit
from livlab.brdf.files.formats import read_brdf, write_fitted
from livlab.brdf.files.mitsuba import read_mitsuba
from livlab.brdf.lookup import lookup
from livlab.brdf.models.model import model
from livlab.brdf.samples import sample_dataset
from livlab.errors import DatasetError, InputError, LivlabError

TRUTH = {"kd": [0.45, 0.2, 0.15], "alpha": [0.15] * 3, "eta": [1.5] * 3, "ks": [1.0] * 3}
RNG = np.random.default_rng(5)
T = np.deg2rad(RNG.uniform(0, 70, (2, 4000)))
WI, WO = direction(T[0], np.zeros(4000)), direction(T[1], RNG.uniform(0, 2 * np.pi, 4000))
VALUE = model("plastic").evaluate(WI, WO, {k: np.array(v) for k, v in TRUTH.items()})
SMOOTH = half_angles(WI, WO).theta_h > np.deg2rad(25)  # where cells of 2° follow the lobe


@pytest.fixture(scope="module")
def found():
    return livlab.brdf.fit_model(sample_dataset(WI, WO, VALUE, channels=["R", "G", "B"]), "plastic", bootstrap=None)


@pytest.fixture(scope="module")
def written(found, tmp_path_factory):
    path = tmp_path_factory.mktemp("fit") / "fit.json"
    path.write_text(found.to_json())
    return path


def test_the_model_is_read_as_it_was_fitted(found, written):
    fitted = read_fit(written)
    assert fitted.channels == ("R", "G", "B")
    np.testing.assert_allclose(fitted.evaluate(WI, WO), VALUE, rtol=1e-4)
    np.testing.assert_array_equal(fitted.evaluate(WI, WO), found.evaluate(WI, WO))


@pytest.mark.parametrize("suffix", [".nc", ".binary", ".bsdf"])
def test_every_format_holds_it_without_holes(found, written, tmp_path, suffix):
    write_fitted(tmp_path / f"a{suffix}", read_fit(written))
    assert livlab.brdf.write(tmp_path / f"b{suffix}", found).is_file()
    assert (tmp_path / f"a{suffix}").stat().st_size == (tmp_path / f"b{suffix}").stat().st_size
    if suffix == ".bsdf":
        value = read_mitsuba(tmp_path / "a.bsdf").evaluate(WI, WO)
        np.testing.assert_allclose(value, VALUE, rtol=0.03)
    else:
        table = read_brdf(tmp_path / f"a{suffix}")
        assert np.isfinite(table["value"].values[~table["hole"].values]).all()
        value = lookup(table, WI, WO)
        np.testing.assert_allclose(value[SMOOTH], VALUE[SMOOTH], rtol=0.05)
    assert np.sqrt(np.mean((value[SMOOTH] / VALUE[SMOOTH] - 1) ** 2)) < 0.004


def test_mitsuba_evaluates_the_exported_file(written, tmp_path):
    from livlab.model.tracer.variant import mitsuba

    write_fitted(tmp_path / "fit.bsdf", read_fit(written))
    before = mitsuba().variant()
    mi = mitsuba("llvm_ad_rgb")
    try:
        bsdf = mi.load_dict({"type": "measured", "filename": str(tmp_path / "fit.bsdf")})
        at = mi.SurfaceInteraction3f()
        at.wi = mi.Vector3f(*WO.T)  # Mitsuba's wi is the camera's side
        seen = np.array(bsdf.eval(mi.BSDFContext(), at, mi.Vector3f(*WI.T))).T / WI[:, 2:]
    finally:
        mitsuba(before)
    assert np.sqrt(np.mean((seen / VALUE - 1) ** 2)) < 0.003


def test_one_channel_and_shared_parameters(tmp_path):
    one = livlab.brdf.fit_model(sample_dataset(WI, WO, VALUE[:, :1]), "plastic", bootstrap=None)
    (tmp_path / "one.json").write_text(one.to_json())
    np.testing.assert_array_equal(read_fit(tmp_path / "one.json").evaluate(WI, WO), one.evaluate(WI, WO))
    write_fitted(tmp_path / "one.bsdf", read_fit(tmp_path / "one.json"))
    assert read_brdf(tmp_path / "one.json").sizes["channel"] == 1


@pytest.mark.parametrize(
    "change",
    [
        lambda r: r | {"model": "no lobe"},
        lambda r: r | {"parameters": r["parameters"][1:]},
        lambda r: r | {"parameters": [p | {"value": None} for p in r["parameters"]]},
        lambda r: r | {"parameters": [p | {"value": 1e9} for p in r["parameters"]]},
        lambda r: r | {"parameters": 5},
        lambda r: [r],
    ],
)
def test_a_damaged_fit_is_refused(written, tmp_path, change):
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(change(json.loads(written.read_text()))))
    with pytest.raises((DatasetError, InputError)) as caught:
        read_fit(path)
    assert caught.value.remedy


@pytest.mark.parametrize("content", [b"", b"[" * 100_000, b"\xff\xfe", b'{"model": 3}'])
def test_what_is_no_json_of_a_fit_is_refused(tmp_path, content):
    path = tmp_path / "bad.json"
    path.write_bytes(content)
    with pytest.raises(LivlabError, match="is no fit"):
        read_fit(path)
    with pytest.raises(DatasetError, match="cannot be read"):
        read_fit(Path(tmp_path / "none.json"))


def test_a_model_of_no_format_is_refused(written, tmp_path):
    with pytest.raises(InputError, match="must end in one of"):
        write_fitted(tmp_path / "a.txt", read_fit(written))
    two = Fitted(model("lambert"), {"kd": np.array([0.2, 0.3])}, ("a", "b"))
    with pytest.raises(InputError, match="1 or 3"):
        write_fitted(tmp_path / "a.bsdf", two)


def test_a_notebook_shows_the_fit_and_draws_it(found, written, tmp_path):
    shown = found._repr_html_()
    assert "<strong>plastic</strong>" in shown
    assert "kd[R]" in shown
    axes = livlab.brdf.plot(sample_dataset(WI, WO, VALUE, channels=["R", "G", "B"]), found)
    assert [ax.name for ax in axes[:2]] == ["polar", "rectilinear"]
    assert axes[0].lines
    axes[0].figure.savefig(tmp_path / "fit.png")
    assert (tmp_path / "fit.png").stat().st_size > 5000
    assert len(livlab.brdf.plot(livlab.brdf.read(written))) >= 2
