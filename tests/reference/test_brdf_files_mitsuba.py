"""Measured materials: Mitsuba loads, evaluates and renders what livlab writes, and livlab reads what Mitsuba does."""

import numpy as np
import pytest
import xarray as xr

from livlab.brdf.angles import direction, from_half_angles
from livlab.brdf.files.formats import read_brdf, write_brdf
from livlab.brdf.files.mitsuba import MitsubaMaterial, read_mitsuba, write_mitsuba
from livlab.brdf.files.tensor import read_tensors, write_tensors
from livlab.brdf.files.warp import Warp
from livlab.brdf.geometry import Camera, Light, Sphere
from livlab.brdf.grid import Grid
from livlab.brdf.lookup import lookup, table_of, tabulate
from livlab.brdf.sphere import extract
from livlab.errors import DatasetError, InputError

COLOURS = np.array([1.0, 0.5, 0.2])


def ggx(wi, wo, alpha=0.15):
    h = wi + wo
    c = h[..., 2] / np.linalg.norm(h, axis=-1)
    spread = alpha**2 / (np.pi * (1 + (alpha**2 - 1) * c**2) ** 2)
    shadow = [2 / (1 + np.sqrt(1 + alpha**2 * (1 / w[..., 2] ** 2 - 1))) for w in (wi, wo)]
    one = 0.2 / np.pi + 0.1 * spread * shadow[0] * shadow[1] / (4 * wi[..., 2] * wo[..., 2])
    return one[..., None] * COLOURS


def everywhere(count=8000, most=75.0):
    """Pairs of directions, half of them near the mirror direction, all within an angle of the normal."""
    rng = np.random.default_rng(1)
    theta, phi = rng.uniform(0, np.deg2rad(most), (2, count)), rng.uniform(-np.pi, np.pi, (2, count))
    a, b = direction(theta[0], phi[0]), direction(theta[1], phi[1])
    c, d = from_half_angles(
        rng.uniform(0, 0.3, count), rng.uniform(0, 1.1, count), *rng.uniform(-np.pi, np.pi, (2, count))
    )
    wi, wo = np.concatenate([a, c]), np.concatenate([b, d])
    good = np.minimum(wi[:, 2], wo[:, 2]) > np.cos(np.deg2rad(most))
    return wi[good], wo[good]


@pytest.fixture(scope="module")
def mitsuba():
    from livlab.machine.llvm import choose_libllvm

    choose_libllvm()
    import mitsuba as mi

    before = mi.variant()
    mi.set_variant("llvm_ad_rgb")
    yield mi
    if before:
        mi.set_variant(before)


def evaluated(mi, path, wi, wo, wavelengths=None):
    """f cos θ_i by Mitsuba, whose wi is the direction to the camera."""
    material = mi.load_dict({"type": "measured", "filename": str(path)}, optimize=False)
    point = mi.SurfaceInteraction3f()
    point.wi = mi.Vector3f(*wo.T.astype(np.float32))
    if wavelengths is not None:
        point.wavelengths = mi.Spectrum(*wavelengths)
    return np.array(material.eval(mi.BSDFContext(), point, mi.Vector3f(*wi.T.astype(np.float32)))).T


def rms(x):
    return float(np.sqrt(np.mean(x**2)))


def test_mitsuba_evaluates_what_was_written(tmp_path, mitsuba):
    wi, wo = everywhere()
    write_mitsuba(tmp_path / "a.bsdf", ggx)
    by_mitsuba = evaluated(mitsuba, tmp_path / "a.bsdf", wi, wo) / wi[:, 2:]
    # livlab's own reading is Mitsuba's to float32: the warp, the order of axes, the cosine and whose wi it is.
    assert read_mitsuba(tmp_path / "a.bsdf").evaluate(wi, wo) == pytest.approx(by_mitsuba, rel=2e-5)
    # And the table is fine enough: within .2 % rms and 2 % at worst, up to 75 degrees.
    error = by_mitsuba / ggx(wi, wo) - 1
    assert rms(error) < 2e-3 and np.max(np.abs(error)) < 2e-2


def test_a_table_with_holes_goes_the_same_way(tmp_path, mitsuba):
    table = tabulate(ggx, Grid.uniform(1, 2, 4), ["R", "G", "B"])
    value = table["value"].values.copy()
    value[:, 40:] = np.nan
    table = table_of(value, Grid.uniform(1, 2, 4), ["R", "G", "B"])
    with pytest.raises(InputError, match="holes"):
        write_brdf(tmp_path / "a.bsdf", table)
    assert not list(tmp_path.iterdir())
    write_brdf(tmp_path / "a.bsdf", table, holes="fill")
    wi, wo = everywhere(most=65.0)
    by_mitsuba = evaluated(mitsuba, tmp_path / "a.bsdf", wi, wo) / wi[:, 2:]
    known = lookup(table, wi, wo)
    assert rms((by_mitsuba / known - 1)[np.isfinite(known)]) < 5e-3
    again = read_brdf(tmp_path / "a.bsdf")
    assert again["channel"].values.tolist() == ["R", "G", "B"]
    assert rms(lookup(again, wi, wo) / ggx(wi, wo) - 1) < 2e-2
    write_brdf(tmp_path / "zero.bsdf", table, holes="zero")
    dark = read_mitsuba(tmp_path / "zero.bsdf").evaluate(*(w[None] for w in from_half_angles(0.05, 1.5, 1.5)))
    assert np.all(dark == 0)


def test_spectral_files(tmp_path, mitsuba):
    wavelengths = [450.0, 550.0, 650.0]
    write_mitsuba(tmp_path / "a.bsdf", ggx, wavelengths_nm=wavelengths)
    read = read_mitsuba(tmp_path / "a.bsdf")
    assert read.channels == wavelengths
    wi, wo = everywhere(1000)
    mitsuba.set_variant("llvm_ad_spectral")
    try:
        got = evaluated(mitsuba, tmp_path / "a.bsdf", wi, wo, [*wavelengths, 600.0]) / wi[:, 2:]
    finally:
        mitsuba.set_variant("llvm_ad_rgb")
    own = read.evaluate(wi, wo)
    assert got[:, :3] == pytest.approx(own, rel=2e-5)
    assert got[:, 3] == pytest.approx((own[:, 1] + own[:, 2]) / 2, rel=2e-5)


def test_warped_tables_with_a_jacobian_are_read_as_mitsuba_reads_them(tmp_path, mitsuba):
    """The form in which the published materials come: a warp by visible normals, values over ndf / (4 sigma)."""
    rng = np.random.default_rng(6)
    theta = np.sort(np.concatenate([[0, np.pi / 2], rng.uniform(0.1, 1.4, 4)]))
    fields = {
        "description": np.frombuffer(b"made up", dtype=np.uint8),
        "phi_i": np.zeros(1, np.float32),
        "theta_i": theta.astype(np.float32),
        "ndf": rng.uniform(0.5, 2, (5, 7)).astype(np.float32),
        "sigma": np.repeat(rng.uniform(0.5, 2, (1, 6)), 4, axis=0).astype(np.float32),  # alike all round: isotropic
        "vndf": rng.uniform(0.2, 2, (1, 6, 9, 8)).astype(np.float32),
        "luminance": rng.uniform(0.2, 2, (1, 6, 7, 7)).astype(np.float32),
        "rgb": rng.uniform(0.2, 2, (1, 6, 3, 7, 7)).astype(np.float32),
        "jacobian": np.ones(1, np.uint8),
    }
    write_tensors(tmp_path / "a.bsdf", fields)
    wi, wo = everywhere(2000)
    material = read_mitsuba(tmp_path / "a.bsdf")
    assert material.description == "made up"
    own = material.evaluate(wi, wo) * wi[:, 2:]
    theirs = evaluated(mitsuba, tmp_path / "a.bsdf", wi, wo)
    assert own == pytest.approx(theirs, rel=5e-4)
    fields["jacobian"] = np.zeros(1, np.uint8)
    write_tensors(tmp_path / "b.bsdf", fields)
    theirs = evaluated(mitsuba, tmp_path / "b.bsdf", wi, wo)
    assert read_mitsuba(tmp_path / "b.bsdf").evaluate(wi, wo) * wi[:, 2:] == pytest.approx(theirs, rel=5e-4)


def test_a_sphere_rendered_with_the_file_gives_the_brdf_back(tmp_path, mitsuba):
    """Once around: function to file, file to Mitsuba's picture of a sphere, picture to samples."""
    mi = mitsuba
    write_mitsuba(tmp_path / "a.bsdf", ggx)
    size, radius_px, distance = 128, 58.0, 200.0
    focal = radius_px * np.sqrt((distance / 20) ** 2 - 1)
    position = [110.0, 40.0, 60.0]
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "sensor": {
                "type": "perspective",
                "fov": float(np.rad2deg(2 * np.arctan(size / 2 / focal))),
                "fov_axis": "x",
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 0], [0, 0, 1], [0, -1, 0]),
                "film": {
                    "type": "hdrfilm",
                    "width": size,
                    "height": size,
                    "rfilter": {"type": "box"},
                    "component_format": "float32",
                },
                "sampler": {"type": "multijitter", "sample_count": 64},
            },
            "ball": {
                "type": "sphere",
                "center": [0, 0, distance],
                "radius": 20.0,
                "bsdf": {"type": "measured", "filename": str(tmp_path / "a.bsdf")},
            },
            "lamp": {"type": "point", "position": position, "intensity": {"type": "rgb", "value": 1e4}},
        },
        optimize=False,
    )
    picture = xr.DataArray(np.array(mi.render(scene, seed=1))[None], dims=("light", "row", "column", "channel"))
    middle = (size - 1) / 2  # Mitsuba counts from the frame's corner, livlab from the first pixel's centre
    camera = Camera(size, size, [[focal, 0, middle], [0, focal, middle], [0, 0, 1]])
    light = Light(np.full(3, 1e4), position_mm=position)
    samples = extract(picture, camera, [light], Sphere([0, 0, distance], 20.0), max_angle=np.deg2rad(75))
    truth = ggx(samples["wi"].values, samples["wo"].values)
    error = samples["value"].values / truth - 1
    assert samples.sizes["sample"] > 5000
    assert rms(error) < 4e-3  # the file .2 %, the pixels' size .15 %, noise of 64 points a pixel


def test_tensor_files_are_mitsubas(tmp_path, mitsuba, capsys):
    from mitsuba.python import tensor_io

    fields = {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "text": np.frombuffer(b"hello", np.uint8)}
    fields |= {"wide": np.arange(4, dtype=np.float64), "count": np.array([[1]], dtype=np.uint16)}
    write_tensors(tmp_path / "ours", fields)
    tensor_io.write(str(tmp_path / "theirs"), **fields)
    for read in (read_tensors(tmp_path / "theirs"), tensor_io.read(str(tmp_path / "ours"))):
        assert list(read) == list(fields)
        for name, values in fields.items():
            assert np.array_equal(read[name], values) and read[name].dtype == values.dtype


def test_warp_spreads_evenly():
    """Uniform points taken back by `invert`: as many fall below a value as the density says, by direct summing."""
    rng = np.random.default_rng(3)
    planes = rng.uniform(0.1, 2, (2, 5, 6))
    warp = Warp(planes, np.array([0.0, 1.0]))
    fine = (np.arange(800) + 0.5) / 800
    u, v = np.meshgrid(fine, fine)
    place = rng.uniform(0, 1)
    mixed = [planes[k] / _integral(planes[k]) for k in (0, 1)]
    density = (1 - place) * _bilinear(mixed[0], u, v) + place * _bilinear(mixed[1], u, v)
    at_u, at_v = warp.invert(np.array([0.37]), np.array([0.81]), np.array([place]))
    assert float(at_v[0]) == pytest.approx(np.mean(density * (v < 0.81)), abs=2e-3)
    row = (1 - place) * _bilinear(mixed[0], fine, 0.81 + 0 * fine) + place * _bilinear(mixed[1], fine, 0.81 + 0 * fine)
    assert float(at_u[0]) == pytest.approx(np.sum(row * (fine < 0.37)) / np.sum(row), abs=2e-3)


def _bilinear(plane, u, v):
    rows, columns = plane.shape
    x, y = u * (columns - 1), v * (rows - 1)
    i, j = np.minimum(x.astype(int), columns - 2), np.minimum(y.astype(int), rows - 2)
    s, t = x - i, y - j
    low = plane[j, i] * (1 - s) + plane[j, i + 1] * s
    high = plane[j + 1, i] * (1 - s) + plane[j + 1, i + 1] * s
    return low * (1 - t) + high * t


def _integral(plane):
    return np.mean((plane[1:, 1:] + plane[1:, :-1] + plane[:-1, 1:] + plane[:-1, :-1]) / 4)


def test_what_is_refused(tmp_path):
    path = tmp_path / "a.bsdf"
    write_mitsuba(path, ggx, size=8, theta_count=4)
    content, fields = path.read_bytes(), read_tensors(path)
    for wrong in (content[:-4], content[:40], b"", b"PNG" + content, content[:14] + b"\xff" * 40):
        path.write_bytes(wrong)
        with pytest.raises(DatasetError):
            read_mitsuba(path)
    for name, values in (("theta_i", np.zeros(3, np.float32)), ("phi_i", np.zeros(5, np.float32)), ("ndf", np.ones(3))):
        write_tensors(path, fields | {name: values})
        with pytest.raises(DatasetError):
            read_mitsuba(path)
    write_tensors(path, {name: values for name, values in fields.items() if name != "vndf"})
    with pytest.raises(DatasetError, match="vndf"):
        read_mitsuba(path)
    with path.open("wb") as stream:
        stream.truncate((1 << 30) + 1)  # sparse: nothing is written
    with pytest.raises(DatasetError, match="more than the 1024 MiB"):
        read_mitsuba(path)
    path.write_bytes(content)
    for brdf, options, match in (
        (ggx, {"wavelengths_nm": [500.0]}, "rising"),
        (ggx, {"wavelengths_nm": [500.0, 400.0, 600.0]}, "rising"),
        (lambda wi, wo: ggx(wi, wo)[:, :2], {}, "1 or 3"),
        (lambda wi, wo: -ggx(wi, wo), {}, "negative"),
        (lambda wi, wo: ggx(wi, wo) * np.nan, {}, "infinite"),
        (ggx, {"size": 2}, "size"),
    ):
        with pytest.raises(InputError, match=match):
            write_mitsuba(path, brdf, **{"size": 8, "theta_count": 4} | options)
    assert path.read_bytes() == content and len(list(tmp_path.iterdir())) == 1
    assert isinstance(read_mitsuba(path), MitsubaMaterial)


def test_near_the_horizon_a_cell_is_right_or_a_hole(tmp_path):
    """Beyond 85 degrees f cos was divided by any number, up to 1600 times too much; a constant comes back exactly."""
    grid = Grid.uniform()
    wi, wo = grid.directions()
    lowest = np.minimum(wi[..., 2], wo[..., 2])
    grazing = grid.reachable() & (lowest < np.cos(np.deg2rad(85))) & (lowest > 0)
    for name, most in ((lambda a, b: np.full((len(a), 3), 0.2), 1e-5), (ggx, 0.2)):
        write_mitsuba(tmp_path / "a.bsdf", name)
        table = read_brdf(tmp_path / "a.bsdf")
        off = table["value"].values / tabulate(name, grid, ["R", "G", "B"])["value"].values - 1
        known = np.isfinite(off).all(axis=-1)
        assert np.max(np.abs(off[known & grazing])) < most
        assert np.all(known[grid.reachable() & ~grazing])
        assert 0.03 < np.mean(known[grazing]) < 0.9  # neither given up nor made up
        assert np.array_equal(table["hole"].values, ~known)


def test_a_warped_file_is_a_hole_near_the_horizon(tmp_path):
    write_mitsuba(tmp_path / "a.bsdf", ggx)
    fields = read_tensors(tmp_path / "a.bsdf") | {"jacobian": np.ones(1, np.uint8)}
    write_tensors(tmp_path / "b.bsdf", fields)
    low = direction(np.deg2rad(np.array([86.0, 89.0, 40.0])), np.zeros(3))
    value = read_mitsuba(tmp_path / "b.bsdf").known(low, direction(np.full(3, 0.3), np.ones(3)))
    assert np.isnan(value[:2]).all() and np.isfinite(value[2]).all()
