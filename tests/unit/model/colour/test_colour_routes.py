from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from livlab.errors import InputError, RangeError
from livlab.model.colour import (
    channel_wavelengths,
    cie_rgb,
    cie_weights,
    delta_e_2000,
    in_gamut,
    out_of_gamut,
    stochastic_rgb,
    thesis_rgb,
    thesis_weights,
    to_rgb,
    to_rgb_error,
)

GRID = np.arange(400.0, 731.0, 10.0)


def spectrum(function, grid=GRID) -> xr.DataArray:
    return xr.DataArray(function(grid), dims="wavelength", coords={"wavelength": grid})


def test_the_thesis_takes_the_mean_at_its_own_wavelengths():
    grid = np.sort(channel_wavelengths(20, 5).ravel())
    values = np.random.default_rng(0).random(15)
    image = xr.DataArray(values, dims="wavelength", coords={"wavelength": grid})
    blue, green, red = values.reshape(3, 5).mean(axis=1)
    assert thesis_rgb(image, 20, 5).to_numpy() == pytest.approx([red, green, blue], abs=1e-15)


def test_one_wavelength_is_the_centre_and_between_two_is_interpolated():
    line = spectrum(lambda x: x / 1000.0)
    assert thesis_rgb(line, 1, 1).to_numpy() == pytest.approx([0.7, 0.5461, 0.4358], abs=1e-12)


def test_an_image_keeps_its_dimensions_and_its_pixels_apart():
    rng = np.random.default_rng(1)
    image = xr.DataArray(
        rng.random((3, 4, len(GRID))), dims=("row", "column", "wavelength"), coords={"wavelength": GRID}
    )
    for route in (thesis_rgb, cie_rgb):
        rgb = route(image)
        assert rgb.dims == ("row", "column", "channel")
        assert list(rgb["channel"].values) == ["R", "G", "B"]
        assert np.allclose(rgb[2, 1], route(image[2, 1]))
    moved = cie_rgb(image.transpose("wavelength", "column", "row"))
    assert np.allclose(moved.transpose("row", "column", "channel"), cie_rgb(image))


def test_wavelengths_as_single_precision_meet_their_weights():
    image = spectrum(np.ones_like).assign_coords(wavelength=GRID.astype(np.float32))
    assert to_rgb(image, cie_weights(GRID)).to_numpy() == pytest.approx([1, 1, 1], abs=1e-12)


def test_red_tissue_is_red_in_every_route():
    red = spectrum(lambda x: 0.05 + 0.4 / (1 + np.exp((600 - x) / 10)))
    for rgb in (thesis_rgb(red), cie_rgb(red), stochastic_rgb(red).rgb):
        assert rgb[0] > 2 * rgb[1] > 0
        assert rgb[0] > 2 * rgb[2]


def test_white_balance_to_a_measured_white():
    tile = spectrum(lambda x: 0.9 - 0.2 * (x - 400) / 300)
    assert cie_rgb(tile, "A", white=tile).to_numpy() == pytest.approx([1, 1, 1], abs=1e-12)
    assert cie_rgb(0.5 * tile, "A", white=tile).to_numpy() == pytest.approx([0.5] * 3, abs=1e-12)
    assert abs(cie_rgb(tile, "A") - cie_rgb(tile, "A").mean()).max() > 0.01


def test_drawn_wavelengths_are_seeded_inside_their_channel_and_stratified():
    regular = channel_wavelengths(20, 8)
    drawn = channel_wavelengths(20, 8, stochastic=True, seed=4)
    assert np.array_equal(drawn, channel_wavelengths(20, 8, stochastic="stratified", seed=4))
    assert not np.array_equal(drawn, channel_wavelengths(20, 8, stochastic=True, seed=5))
    edges = regular.mean(axis=1, keepdims=True) + np.linspace(-20, 20, 9)
    assert np.all((drawn >= edges[:, :-1]) & (drawn <= edges[:, 1:]))
    free = channel_wavelengths(20, 8, stochastic="uniform", seed=4)
    assert np.all(np.abs(free - regular.mean(axis=1, keepdims=True)) <= 20)
    assert not np.all((free >= edges[:, :-1]) & (free <= edges[:, 1:]))


@pytest.mark.parametrize(("count", "stratified"), [(3, True), (5, True), (5, False)])
def test_the_error_stated_for_a_draw_is_the_scatter_over_draws(count, stratified):
    fine = np.arange(400.0, 731.0, 1.0)
    wave = spectrum(lambda x: 0.3 + 0.2 * np.sin((x - 400) / 60), fine)
    found = [stochastic_rgb(wave, 20, count, stratified=stratified, seed=s) for s in range(300)]
    values = np.array([f.rgb for f in found])
    stated = np.sqrt((np.array([f.rgb_se for f in found]) ** 2).mean(axis=0))
    scatter = values.std(axis=0, ddof=1)
    uncertain = 3.5 / np.sqrt(2 * 300)
    # A curvature c adds (c h²)²/6 to the spread of strata of width h; here c is at most 0.2/60².
    curved = (0.2 / 60**2 * (40 / count) ** 2) ** 2 / 6 / count if stratified else 0.0
    assert np.all(stated > (1 - uncertain) * scatter)
    assert np.all(stated < np.sqrt(((1 + uncertain) * scatter) ** 2 + curved))
    truth = thesis_rgb(wave, 20, 401)
    assert np.all(np.abs(values.mean(axis=0) - truth) < 4 * scatter / np.sqrt(300) + 1e-4)


def test_stratified_draws_err_less_and_one_draw_tells_no_error():
    fine = spectrum(lambda x: x / 1000.0, np.arange(400.0, 731.0))
    scatter = [
        np.std([stochastic_rgb(fine, 20, 5, stratified=s, seed=k).rgb[0] for k in range(60)]) for s in (True, False)
    ]
    assert scatter[0] < 0.4 * scatter[1]  # 1/5 is expected of a straight line
    assert np.isnan(stochastic_rgb(fine, 20, 1).rgb_se).all()


def test_errors_reach_the_colour_as_simulated():
    rng = np.random.default_rng(7)
    weights = cie_weights(GRID)
    sigma = spectrum(lambda x: 0.01 + 0.02 * (x > 600))
    independent = rng.normal(size=(4000, len(GRID))) * sigma.to_numpy()
    noise = xr.DataArray(independent, dims=("draw", "wavelength"), coords={"wavelength": GRID})
    found = to_rgb(noise, weights).std("draw")
    stated = to_rgb_error(sigma, weights, dependence="independent")
    assert np.abs(found / stated - 1).max() < 4 / np.sqrt(8000)
    together = xr.DataArray(
        rng.normal(size=(4000, 1)) * sigma.to_numpy(), dims=("draw", "wavelength"), coords={"wavelength": GRID}
    )
    bound = to_rgb_error(sigma, weights)
    assert np.all(to_rgb(together, weights).std("draw") <= bound * (1 + 4 / np.sqrt(8000)))
    assert np.all(stated <= bound)
    # Errors that all have the sign of their weight reach the bound.
    assert to_rgb(sigma * np.sign(weights.sel(channel="R", drop=True)), weights)[0] == pytest.approx(float(bound[0]))


def test_colours_outside_srgb_are_counted_and_brought_back():
    rgb = xr.DataArray(
        [[-0.1, 0.5, 0.5], [0.2, 0.2, 1.4], [0.1, 0.2, 0.3], [np.nan, 0.1, 0.1], [0, 0, 0], [-0.3, 0, 0]],
        dims=("pixel", "channel"),
    )
    found = out_of_gamut(rgb)
    assert (found.colours, found.below, found.above) == (5, 2, 1)
    assert (found.lowest, found.highest) == (-0.3, 1.4)
    for how in ("clip", "desaturate"):
        moved = in_gamut(rgb, how)
        assert float(moved.min()) >= 0
        assert float(moved.max()) <= 1
        assert np.array_equal(moved[2], rgb[2])
        assert moved.attrs["gamut_below"] == 2
    luminance = [0.21263900587, 0.71516867877, 0.07219231536]
    assert in_gamut(rgb, "desaturate")[0].to_numpy() @ luminance == pytest.approx(
        rgb[0].to_numpy() @ luminance, abs=1e-9
    )
    assert float(in_gamut(rgb, ceiling=np.inf)[1, 2]) == 1.4


def test_the_routes_differ_and_the_difference_has_a_map():
    image = spectrum(lambda x: 0.05 + 0.4 / (1 + np.exp((600 - x) / 10))).expand_dims(row=2, column=3)
    difference = delta_e_2000(thesis_rgb(image), cie_rgb(image))
    assert difference.dims == ("row", "column")
    assert np.all(difference > 2)


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: channel_wavelengths(-1, 5), "kappa_nm"),
        (lambda: channel_wavelengths(500, 5), "kappa_nm"),
        (lambda: channel_wavelengths(20, 0), "count"),
        (lambda: channel_wavelengths(20, 5, stochastic="often"), "stochastic"),
        (lambda: thesis_weights(GRID[::-1]), "wavelength"),
        (lambda: cie_weights(GRID, "D66"), "illuminant"),
        (lambda: cie_weights(GRID, observer="nobody"), "observer"),
        (lambda: cie_weights(GRID, adaptation="some"), "adaptation"),
        (lambda: cie_weights(GRID, interpolation="some"), "interpolation"),
        (lambda: cie_weights(GRID, white=spectrum(lambda x: 0 * x)), "white"),
        (lambda: thesis_rgb(xr.DataArray([1.0], dims="x")), "radiance"),
        (lambda: cie_rgb(xr.DataArray([1.0], dims="x")), "wavelength"),
        (lambda: to_rgb(spectrum(np.ones_like, GRID + 1), cie_weights(GRID)), "weights"),
        (lambda: to_rgb_error(-spectrum(np.ones_like), cie_weights(GRID)), "radiance_se"),
        (lambda: delta_e_2000(xr.DataArray([1.0]), xr.DataArray([1.0])), "rgb"),
    ],
)
def test_bad_input_is_refused_by_name(call, field):
    with pytest.raises(InputError, match=field):
        call()


def test_wavelengths_that_leave_too_much_unseen_are_refused():
    with pytest.raises(RangeError, match="luminance"):
        cie_weights(np.arange(500.0, 721.0, 20.0))
    with pytest.raises(RangeError, match=r"719|720"):
        thesis_weights(np.arange(400.0, 711.0, 10.0))
    assert cie_weights(np.arange(400.0, 701.0, 10.0)).attrs["unseen_share"] < 0.01
