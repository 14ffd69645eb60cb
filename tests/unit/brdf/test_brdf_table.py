"""Tables of half-angle cells: sums against loops, holes, reciprocity, reading values off."""

import numpy as np
import pytest
import xarray as xr

from livlab.brdf.angles import direction, from_half_angles, half_angles
from livlab.brdf.geometry import Camera, Light, Sphere
from livlab.brdf.grid import Grid, grid_of
from livlab.brdf.lookup import fill_holes, lookup, table_of, tabulate
from livlab.brdf.samples import sample_dataset
from livlab.brdf.sphere import extract
from livlab.brdf.table import merge
from livlab.errors import InputError

COARSE = Grid.uniform(10, 15, 30)


def pairs(count, seed=0, most=80.0):
    """Directions within an angle of the normal, uniform over the sphere's cap."""
    rng = np.random.default_rng(seed)
    cosine = rng.uniform(np.cos(np.deg2rad(most)), 1, (2, count))
    turn = rng.uniform(-np.pi, np.pi, (2, count))
    return direction(np.arccos(cosine[0]), turn[0]), direction(np.arccos(cosine[1]), turn[1])


def smooth(wi, wo):
    """Reciprocal, isotropic, different in each channel."""
    h = half_angles(wi, wo)
    one = 0.2 + 0.1 * np.cos(h.theta_h) ** 3 + 0.05 * np.sin(h.theta_d) ** 2 * np.cos(2 * h.phi_d)
    return np.stack([one, 2 - np.sin(h.theta_d) ** 2], axis=-1)


def samples_of(f, count=4000, seed=0, error=None, **extra):
    wi, wo = pairs(count, seed)
    value = f(wi, wo)
    return sample_dataset(wi, wo, value, standard_error=error, extra=extra)


@pytest.mark.parametrize("weighting", ["area", "inverse_variance", "uniform"])
def test_means_are_those_of_a_loop(weighting):
    rng = np.random.default_rng(5)
    count = 3000
    area, error = rng.uniform(0.5, 2, count), rng.uniform(0.01, 0.1, (count, 2))
    data = samples_of(smooth, count, error=error, area=area)
    table = merge(data, COARSE, weighting=weighting)
    members: dict[tuple[int, ...], list[int]] = {}
    for j in range(count):
        one = data.isel(sample=j)
        phi = float(one["phi_d"]) % np.pi
        cell = (
            int(np.rad2deg(float(one["theta_h"])) // 10),
            int(np.rad2deg(float(one["theta_d"])) // 15),
            min(int(np.rad2deg(phi) // 30), 5),
        )
        members.setdefault(cell, []).append(j)
    assert int(table["count"].sum()) == count and int((~table["hole"]).sum()) == len(members)
    for cell, inside in members.items():
        for c in (0, 1):
            weight = {"area": area[inside], "inverse_variance": error[inside, c] ** -2.0}.get(
                weighting, np.ones(len(inside))
            )
            value = data["value"].values[inside, c]
            mean = np.sum(weight * value) / np.sum(weight)
            got = table.isel(channel=c)
            assert float(got["value"][cell]) == pytest.approx(mean, rel=1e-12)
            noise = np.sqrt(np.sum((weight * error[inside, c]) ** 2)) / np.sum(weight)
            assert float(got["standard_error"][cell]) == pytest.approx(noise, rel=1e-12)
            spread = np.sqrt(np.sum(weight * (value - mean) ** 2) / np.sum(weight))
            if len(inside) > 1:
                assert float(got["spread"][cell]) == pytest.approx(spread, rel=1e-9, abs=1e-14)
            else:
                assert np.isnan(float(got["spread"][cell]))
        assert int(table["count"][cell]) == len(inside)
    assert table.attrs["standard_error_from"].startswith("standard errors")


def test_standard_error_from_the_spread_covers_the_truth():
    """4000 samples of one value with noise of a known size: the cells' means scatter as their errors say."""
    rng = np.random.default_rng(8)
    wi, wo = pairs(40000, 3)
    table = merge(sample_dataset(wi, wo, 0.3 + 0.05 * rng.normal(size=40000)), COARSE)
    full = table.where(table["count"] >= 20)
    pulls = ((full["value"] - 0.3) / full["standard_error"]).values
    pulls = pulls[np.isfinite(pulls)]
    assert len(pulls) > 150
    assert abs(pulls.mean()) < 4 / np.sqrt(len(pulls)) and abs(pulls.std() - 1) < 0.2
    assert table.attrs["standard_error_from"].startswith("spread")


def test_batches_add_up_to_the_whole():
    data = samples_of(smooth, 5000)
    parts = [data.isel(sample=slice(k, None, 3)) for k in range(3)]
    one, three = merge(data, COARSE), merge(iter(parts), COARSE)
    for name in ("value", "spread", "standard_error", "reciprocity_residual", "theta_h_mean", "phi_d_mean"):
        assert three[name].values == pytest.approx(one[name].values, rel=1e-9, abs=1e-12, nan_ok=True)
    assert np.array_equal(three["count"].values, one["count"].values)


def test_reciprocity_residual_is_that_of_the_function():
    grid = Grid.uniform(5, 5, 10)
    kept = merge(samples_of(smooth, 200000), grid)
    assert kept.attrs["reciprocity_cells"] > 1000

    def lopsided(wi, wo):
        return (1 + 0.2 * (wi[:, 2] - wo[:, 2]))[:, None]

    table = merge(samples_of(lopsided, 200000), grid)
    middle_i, middle_o = grid.directions()
    expected = 0.4 * (middle_i[..., 2] - middle_o[..., 2])  # (f(i, o) - f(o, i)) over their mean, 1
    residual = table["reciprocity_residual"].isel(channel=0).values
    sure = np.isfinite(residual) & (table["count"].values > 30)
    assert sure.sum() > 1000
    assert np.corrcoef(residual[sure], expected[sure])[0, 1] > 0.99
    assert np.sqrt(np.mean((residual - expected)[sure] ** 2)) < 0.02
    # A reciprocal function shows nothing but its change within a cell.
    rest = kept["reciprocity_residual"].isel(channel=0).values[kept["count"].values > 30]
    assert np.nanstd(rest) < 0.02


def test_mirror_grid_halves_the_azimuth():
    grid = Grid.uniform(10, 15, 30, mirror=True)
    assert grid.shape == (9, 6, 3)
    data = samples_of(smooth, 20000)
    table = merge(data, grid)
    assert int(table["count"].sum()) == 20000
    there = lookup(table, data["wi"].values, data["wo"].values)
    assert np.nanmax(np.abs(there / smooth(data["wi"].values, data["wo"].values) - 1)) < 0.2
    flip = np.array([1, -1, 1])
    assert lookup(table, data["wi"].values * flip, data["wo"].values * flip) == pytest.approx(
        there, rel=1e-9, nan_ok=True
    )


@pytest.mark.parametrize(("step", "published"), [(5, 0.88), (10, 0.55), (20, 0.30)])
def test_coverage_of_an_arc_of_lights(step, published):
    """Against shares found elsewhere: one camera, lights over 10-170 degrees, cells of 2 x 2 x 4 degrees, R 115 px."""
    focal = 115 * np.sqrt(99)
    view = Camera(250, 250, [[focal, 0, 124.5], [0, focal, 124.5], [0, 0, 1]], translation=[0, 0, 200.0])
    arc = np.deg2rad(np.arange(10, 170.1, step))
    lights = [Light(np.ones(1), direction=[np.sin(a), 0.0, -np.cos(a)]) for a in arc]
    images = xr.DataArray(np.ones((len(arc), 250, 250)), dims=("light", "row", "column"))
    table = merge(extract(images, view, lights, Sphere([0, 0, 0], 20.0), empty_lights="skip"))
    assert table.attrs["coverage"] == pytest.approx(published, abs=0.03)
    holes = table["hole"].values
    assert table.attrs["coverage"] == pytest.approx(1 - holes[table["reachable"].values].mean(), abs=1e-12)


def test_merl_grid_places_samples_as_its_readers_do():
    grid = Grid.merl()
    rng = np.random.default_rng(2)
    theta_h, theta_d = rng.uniform(0, np.pi / 2, (2, 500))
    phi_d = rng.uniform(0, np.pi, 500)
    cell = grid.place(theta_h, theta_d, phi_d).cell
    expected = [
        int(np.sqrt(h / (np.pi / 2) * 90 * 90)) * 90 * 180 + int(d / (np.pi / 2) * 90) * 180 + int(p / np.pi * 180)
        for h, d, p in zip(theta_h, theta_d, phi_d, strict=True)
    ]
    assert cell.tolist() == expected
    back = grid.place(*(axis.ravel() for axis in np.meshgrid(*grid.centres(), indexing="ij"))).cell
    assert np.array_equal(back, np.arange(grid.size))


def test_lookup_follows_a_smooth_function():
    wi, wo = pairs(3000, 4)
    truth = smooth(wi, wo)
    errors = [np.max(np.abs(lookup(tabulate(smooth, Grid.uniform(s, s, 2 * s)), wi, wo) - truth)) for s in (4, 2)]
    # Second order in the cell inside; near the horizon cells below it are missing and it is first order.
    assert errors[1] < 0.6 * errors[0] and errors[1] < 0.01
    near = lookup(tabulate(smooth), wi, wo, method="nearest")
    assert np.max(np.abs(near - truth)) < 0.05
    assert np.array_equal(lookup(tabulate(smooth), wi, wo * [1, 1, -1]), np.full((3000, 2), np.nan), equal_nan=True)


def test_holes_stay_holes_until_asked_and_are_marked_then():
    whole = tabulate(smooth, COARSE)
    value = whole["value"].values.copy()
    value[2, 1, 1] = value[4, 2, :] = np.nan
    table = table_of(value, COARSE, None)
    assert int(table["hole"].sum()) == int(whole["hole"].sum()) + 7 and not table["filled"].any()
    wi, wo = from_half_angles(*(axis[i] for axis, i in zip(COARSE.centres(), (4, 2, 3), strict=True)))
    assert np.isnan(lookup(table, wi[None], wo[None], method="nearest")).all()
    filled = fill_holes(table)
    marks = filled["filled"].values
    assert marks[2, 1, 1] == 1 and np.array_equal(filled["value"].values[2, 1, 1], value[2, 1, 4])
    above = COARSE.reachable()
    assert np.all(marks[4, 2, above[4, 2]] == 2)
    assert np.isfinite(filled["value"].values[above]).all() and np.isnan(filled["value"].values[~above]).all()
    assert np.array_equal(filled["hole"].values, table["hole"].values)
    known = np.isfinite(value)
    assert np.array_equal(filled["value"].values[known], value[known])
    # The nearest cell is the next one along the azimuth or in θ_d, not far away.
    assert np.nanmax(np.abs(filled["value"].values / whole["value"].values - 1)) < 0.2
    only = fill_holes(table, ("nearest",))
    assert only["filled"].values[2, 1, 1] == 2


def test_nearest_filling_goes_around_the_fold():
    value = np.full((*COARSE.shape, 1), np.nan)
    value[3, 2, 0], value[3, 2, 3] = 1.0, 2.0
    filled = fill_holes(table_of(value, COARSE, None), ("nearest",))
    assert filled["value"].values[3, 2, :, 0].tolist() == [1.0, 1.0, 2.0, 2.0, 2.0, 1.0]


def test_what_is_refused():
    data = samples_of(smooth, 100)
    for grid in (([0, 1.0], [0, np.pi / 2], [0, np.pi]), ([0, 1.0, 0.5, np.pi / 2], [0, np.pi / 2], [0, np.pi])):
        with pytest.raises(InputError, match="theta_h"):
            Grid(*grid)
    with pytest.raises(InputError, match="phi_d"):
        Grid([0, np.pi / 2], [0, np.pi / 2], [0, 2 * np.pi])
    with pytest.raises(InputError, match="degrees"):
        Grid.uniform(0)
    with pytest.raises(InputError, match="inverse variance"):
        merge(data, COARSE, weighting="inverse_variance")
    with pytest.raises(InputError, match="weighting"):
        merge(data, COARSE, weighting="median")
    with pytest.raises(InputError, match="at least one sample"):
        merge(data.isel(sample=slice(0, 0)), COARSE)
    with pytest.raises(InputError, match="at least one sample"):
        merge([], COARSE)
    with pytest.raises(InputError, match="every batch"):
        merge([data, data.isel(channel=[0])], COARSE)
    with pytest.raises(InputError, match="wi"):
        merge(data.drop_vars("wi"), COARSE)
    with pytest.raises(InputError, match="unit vector"):
        merge(data.assign(wi=data["wi"] * 2), COARSE)
    with pytest.raises(InputError, match="table"):
        grid_of(data)
    with pytest.raises(InputError, match="mirror, nearest"):
        fill_holes(tabulate(smooth, COARSE), ("zero",))
    with pytest.raises(InputError, match="at least one value"):
        fill_holes(table_of(np.full((*COARSE.shape, 1), np.nan), COARSE, None))
    with pytest.raises(InputError, match="one row for each sample"):
        sample_dataset(np.eye(3), np.eye(3), np.ones(4))
    with pytest.raises(InputError, match="standard_error"):
        sample_dataset(np.eye(3), np.eye(3), np.ones(3), standard_error=np.ones(2))
