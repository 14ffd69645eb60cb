"""Files of BRDFs come back as they were written, and bad ones are refused whole."""

import numpy as np
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from livlab.brdf.angles import direction
from livlab.brdf.files.alta import read_alta
from livlab.brdf.files.csv import read_csv, write_csv
from livlab.brdf.files.formats import read_brdf, write_brdf
from livlab.brdf.files.merl import SCALES, read_merl, write_merl
from livlab.brdf.files.netcdf import read_netcdf, write_netcdf
from livlab.brdf.footprint import footprint
from livlab.brdf.geometry import Camera, Light, Sphere
from livlab.brdf.grid import Grid
from livlab.brdf.lookup import fill_holes, lookup, table_of, tabulate
from livlab.brdf.rig import rig_of
from livlab.brdf.samples import sample_dataset
from livlab.brdf.sphere import Noise, extract
from livlab.brdf.table import cells_as_samples, merge
from livlab.errors import DatasetError, EnvironmentProblem, InputError


def glossy(wi, wo):
    h = wi + wo
    h = h / np.linalg.norm(h, axis=-1, keepdims=True)
    lobe = 0.1 + 2 * np.maximum(h[..., 2], 0) ** 40
    return np.stack([lobe, 0.5 * lobe, 0.1 + 0 * lobe], axis=-1)


@pytest.fixture(scope="module")
def samples():
    view = Camera(48, 48, [[200.0, 0, 23.5], [0, 200, 23.5], [0, 0, 1]], translation=[0, 0, 200.0])
    lights = [Light(np.ones(2), direction=[0, 0, -1]), Light(np.ones(2), position_mm=[50.0, 30, -100])]
    images = xr.DataArray(
        np.random.default_rng(0).uniform(0.1, 1, (2, 48, 48, 2)),
        dims=("light", "row", "column", "channel"),
        coords={"channel": ["green", "red"]},
    )
    return extract(images, view, lights, Sphere([0, 0, 0], 20.0), variance=Noise(read=0.01))


def identical(a, b):
    xr.testing.assert_identical(a.drop_attrs(), b.drop_attrs())
    for name in a.variables:
        assert a[name].dtype == b[name].dtype or a[name].dtype.kind in "UO", name


def test_netcdf_keeps_everything(tmp_path, samples):
    table = fill_holes(merge(samples, Grid.uniform(10, 10, 20)))
    for data in (samples, table):
        write_netcdf(tmp_path / "a.nc", data)
        back = read_netcdf(tmp_path / "a.nc")
        identical(data, back)
        for key, value in data.attrs.items():
            assert np.array_equal(back.attrs[key], value), key
        for name in data.data_vars:
            assert data[name].attrs.items() <= back[name].attrs.items(), name
    write_netcdf(tmp_path / "a.nc", samples)
    assert rig_of(read_netcdf(tmp_path / "a.nc"))[1][1].position_mm.tolist() == [50, 30, -100]


def test_footprints_of_samples_read_from_a_file(tmp_path, samples):
    bare = samples.assign(standard_error=samples["standard_error"] * np.nan)
    write_netcdf(tmp_path / "a.nc", bare)
    some = np.arange(0, samples.sizes["sample"], 50)
    there = footprint(read_netcdf(tmp_path / "a.nc").isel(sample=some), 3)
    assert np.array_equal(there.weight, footprint(samples, 3, index=some).weight)


def test_netcdf_spells_out_its_conventions(tmp_path, samples):
    write_netcdf(tmp_path / "a.nc", samples)
    with xr.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as raw:
        assert "to the light" in raw.attrs["wi"] and "to the eye" in raw.attrs["wo"]
        assert "without the cosine" in raw.attrs["quantity"] and raw.attrs["value_units"] == "1/sr"
        assert raw["value"].attrs["units"] == "1/sr" and "normal" in raw.attrs["frame"]
        for key, wrong in (("quantity", "BRDF times cosine"), ("wi", "to the eye"), ("livlab_brdf_format", 99)):
            raw.load().assign_attrs({key: wrong}).to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
            with pytest.raises(DatasetError):
                read_netcdf(tmp_path / "b.nc")


vectors = hnp.arrays(np.float64, (5, 2), elements=st.floats(0.0, 1.5))
numbers = hnp.arrays(np.float64, (5, 2), elements=st.floats(allow_nan=True, allow_infinity=False))


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(vectors, vectors, numbers, numbers)
def test_csv_keeps_every_bit(tmp_path, to_light, to_eye, value, error):
    wi, wo = direction(to_light[:, 0], to_light[:, 1]), direction(to_eye[:, 0], 3 * to_eye[:, 1])
    data = sample_dataset(wi, wo, value, standard_error=error, channels=["R", 550], extra={"light": np.arange(5)})
    write_csv(tmp_path / "a.csv", data)
    back = read_csv(tmp_path / "a.csv")
    for name in ("wi", "wo", "value", "standard_error", "theta_h", "phi_d"):
        assert np.array_equal(back[name].values, data[name].values, equal_nan=True), name
    assert back["light"].values.tolist() == [0, 1, 2, 3, 4]
    assert [str(name) for name in back["channel"].values] == ["R", "550"]


def test_csv_of_extracted_samples_and_by_hand(tmp_path, samples):
    write_brdf(tmp_path / "a.csv", samples)
    text = (tmp_path / "a.csv").read_text()
    assert text.startswith("# livlab BRDF samples 1\n") and "without the cosine" in text and "1/sr" in text
    back = read_brdf(tmp_path / "a.csv")
    for name in ("wi", "value", "standard_error", "row", "column", "light", "area", "source_solid_angle"):
        assert np.array_equal(back[name].values, samples[name].values), name
    hand = "# from a paper\ntheta_i_deg, phi_i_deg, theta_o_deg, phi_o_deg, value_0\n45,0,45,180,0.3\n45,0,0,0,0.2\n"
    (tmp_path / "b.csv").write_text(hand)
    typed = read_csv(tmp_path / "b.csv")
    assert typed["theta_i"].values == pytest.approx(np.pi / 4) and typed["value"].values[:, 0].tolist() == [0.3, 0.2]
    assert typed["theta_h"].values == pytest.approx([0, np.pi / 8], abs=1e-15)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "wi_x,wi_y\n1,2\n",
        "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,value_0\n",
        "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,value_0,value_0\n1,2,3,4,5,6\n",
        "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg\n1,2,3,4\n",
        "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,value_0,colour\n1,2,3,4,5,6\n",
        "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,value_0\n1,2,3,4,many\n",
        "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,value_0\n1,,3,4,5\n",
        "wi_x,wi_y,wi_z,wo_x,wo_y,wo_z,value_0\n0,0,2,0,0,1,1\n",
        "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,value_0\n1,2,3,4,5,6\n1,2\n",
    ],
)
def test_bad_csv(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(DatasetError):
        read_csv(tmp_path / "a.csv")


def test_merl_comes_back_and_its_bytes_are_where_they_belong(tmp_path):
    table = tabulate(glossy, Grid.merl(), ["R", "G", "B"])
    value = table["value"].values.copy()
    value[3, 4, 5] = np.nan
    table = table_of(value, Grid.merl(), ["R", "G", "B"])
    write_merl(tmp_path / "a.binary", table)
    content = (tmp_path / "a.binary").read_bytes()
    assert len(content) == 12 + 3 * 8 * 90 * 90 * 180
    assert np.frombuffer(content, "<i4", 3).tolist() == [90, 90, 180]
    plane = np.frombuffer(content, "<f8", offset=12)
    for h, d, p in ((0, 10, 3), (3, 4, 5), (20, 30, 100), (89, 89, 179)):
        for c in range(3):
            stored = plane[180 * (90 * (90 * c + h) + d) + p]
            expected = value[h, d, p, c] / SCALES[c] if np.isfinite(value[h, d, p, c]) else -1
            assert stored == pytest.approx(expected, rel=1e-15)
    back = read_merl(tmp_path / "a.binary")
    assert np.allclose(back["value"].values, value, rtol=1e-15, atol=0, equal_nan=True)
    assert np.array_equal(back["hole"].values, table["hole"].values) and bool(back["hole"].values[3, 4, 5])


def test_merl_of_another_grid_and_of_one_channel(tmp_path):
    def soft(wi, wo):
        return 0.3 + 0.1 * wi[:, 2] * wo[:, 2]

    table = tabulate(soft)
    write_brdf(tmp_path / "a.binary", table)
    back = read_brdf(tmp_path / "a.binary")
    red, blue = back["value"].values[..., 0], back["value"].values[..., 2]
    assert np.allclose(red, blue, rtol=1e-14, atol=0, equal_nan=True)
    wi, wo = direction(np.linspace(0, 1.2, 50), 0.3), direction(np.linspace(1.1, 0.1, 50), 2.0)
    assert lookup(back, wi, wo)[:, 1] == pytest.approx(soft(wi, wo), rel=2e-3)


def test_bad_merl(tmp_path):
    table = tabulate(glossy, Grid.merl())
    path = tmp_path / "a.binary"
    write_merl(path, table)
    content = path.read_bytes()
    other = np.array([90, 90, 360], "<i4").tobytes() + content[12:]
    for wrong in (content[:-8], content + b"\0" * 8, b"", content[:10], other):
        path.write_bytes(wrong)
        with pytest.raises(DatasetError, match="bytes"):
            read_merl(path)
    with pytest.raises(DatasetError, match="cannot be read"):
        read_merl(tmp_path / "none.binary")
    path.write_bytes(content)
    with pytest.raises(InputError, match="channels"):
        write_merl(path, table.isel(channel=[0, 1]))
    with pytest.raises(InputError, match=">= 0"):
        write_merl(path, table.assign(value=-table["value"]))
    assert path.read_bytes() == content and [p.name for p in tmp_path.iterdir()] == ["a.binary"]
    with pytest.raises(EnvironmentProblem):
        write_merl(tmp_path / "missing" / "a.binary", table)


ALTA = """#ALTA HEADER BEGIN
#DIM {dim}
#PARAM_IN  {kind}
#PARAM_OUT {out}
#VS 0
#ALTA HEADER END
# a comment
{rows}
"""


@pytest.mark.parametrize(
    ("kind", "row", "theta_i", "theta_o", "apart"),
    [
        ("ISOTROPIC_TV_TL_DPHI", "0.2 0.7 1.0", 0.7, 0.2, 1.0),
        ("SPHERICAL_TL_PL_TV_PV", "0.7 0.5 0.2 -0.5", 0.7, 0.2, 1.0),
        ("RUSIN_TH_TD_PD", "0.3 0.4 0.0", 0.7, 0.1, np.pi),
        ("RUSIN_TH_PH_TD_PD", "0.3 1.2 0.4 3.141592653589793", 0.1, 0.7, np.pi),
        ("RUSIN_TH_TD", "0.0 0.4", 0.4, 0.4, np.pi),
        ("CARTESIAN", "0 0 1 0.6 0 0.8", np.arccos(0.8), 0.0, None),
    ],
)
def test_alta_parametrisations(tmp_path, kind, row, theta_i, theta_o, apart):
    path = tmp_path / "a.alta"
    path.write_text(ALTA.format(dim=f"{len(row.split())} 1", kind=kind, out="INV_STERADIAN", rows=row + " 0.25"))
    data = read_alta(path)
    assert float(data["theta_i"][0]) == pytest.approx(theta_i) and float(data["theta_o"][0]) == pytest.approx(theta_o)
    assert data["value"].values.tolist() == [[0.25]] and data.attrs["alta_param_in"] == kind
    if kind.startswith(("ISO", "SPH")):
        wi, wo = data["wi"].values[0], data["wo"].values[0]
        turn = abs(np.arctan2(wi[1], wi[0]) - np.arctan2(wo[1], wo[0]))
        assert turn == pytest.approx(apart)


def test_alta_outputs(tmp_path):
    path = tmp_path / "a.txt"
    rows = "0.2 0.7 1.0 0.1 0.2 0.3\n0.1 0.5 2.0 0.4 0.5 0.6"
    path.write_text(ALTA.format(dim="3 3", kind="ISOTROPIC_TV_TL_DPHI", out="RGB_COLOR", rows=rows))
    data = read_brdf(path)
    assert data["channel"].values.tolist() == ["R", "G", "B"] and data["value"].values[1].tolist() == [0.4, 0.5, 0.6]
    cosine = ALTA.format(
        dim="3 1", kind="ISOTROPIC_TV_TL_DPHI", out="INV_STERADIAN_COSINE_FACTOR", rows="0.2 0.7 1 0.1"
    )
    path.write_text(cosine)
    assert read_brdf(path)["value"].values[0, 0] == pytest.approx(0.1 / np.cos(0.7))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "#DIM 3 1\n#PARAM_OUT INV_STERADIAN\n1 1 1 1\n",
        ALTA.format(dim="3 1", kind="STARK_3D", out="INV_STERADIAN", rows="1 1 1 1"),
        ALTA.format(dim="3 1", kind="RUSIN_TH_TD_PD", out="ENERGY", rows="1 1 1 1"),
        ALTA.format(dim="2 1", kind="RUSIN_TH_TD_PD", out="INV_STERADIAN", rows="1 1 1 1"),
        ALTA.format(dim="3 1", kind="RUSIN_TH_TD_PD", out="INV_STERADIAN", rows="1 1 1 1\n1 1"),
        ALTA.format(dim="3 1", kind="RUSIN_TH_TD_PD", out="INV_STERADIAN", rows="1 1 x 1"),
        ALTA.format(dim="3 1", kind="RUSIN_TH_TD_PD", out="INV_STERADIAN", rows=""),
        ALTA.format(dim="6 1", kind="CARTESIAN", out="INV_STERADIAN", rows="0 0 2 0 0 1 1"),
        ALTA.format(dim="3 1", kind="ISOTROPIC_TV_TL_DPHI", out="INV_STERADIAN_COSINE_FACTOR", rows="0 1.6 0 1"),
    ],
)
def test_bad_alta(tmp_path, text):
    path = tmp_path / "a.alta"
    path.write_text(text)
    with pytest.raises(DatasetError):
        read_alta(path)


def test_cells_as_samples_and_suffixes(tmp_path, samples):
    table = merge(samples, Grid.uniform(10, 10, 20))
    cells = cells_as_samples(table)
    assert cells.sizes["sample"] == int((~table["hole"] & Grid.uniform(10, 10, 20).reachable()).sum())
    again = merge(cells, Grid.uniform(10, 10, 20), weighting="uniform")
    both = np.isfinite(again["value"].values) & np.isfinite(table["value"].values)
    assert np.array_equal(again["value"].values[both], table["value"].values[both])
    write_brdf(tmp_path / "a.csv", table)
    assert read_brdf(tmp_path / "a.csv").sizes["sample"] == cells.sizes["sample"]
    for name in ("a.xyz", "a.alta"):
        with pytest.raises(InputError, match="must end in"):
            write_brdf(tmp_path / name, table)
    with pytest.raises(InputError, match="must end in"):
        read_brdf(tmp_path / "a.png")
    with pytest.raises(InputError, match="kind"):
        write_brdf(tmp_path / "a.nc", xr.Dataset())
    for name in ("none.nc", "none.csv", "none.bsdf", "none.alta", "none.binary"):
        with pytest.raises(DatasetError):
            read_brdf(tmp_path / name)
    for name in ("cut.nc", "cut.bsdf"):
        (tmp_path / name).write_bytes(b"nothing of the kind")
        with pytest.raises(DatasetError):
            read_brdf(tmp_path / name)
