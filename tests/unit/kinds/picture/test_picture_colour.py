"""Colour routes of a picture, its mean colour and its claims."""

from __future__ import annotations

from typing import get_args

import colour as reference
import numpy as np
import pytest
import xarray as xr
from picture_fakes import small

from livlab.errors import RangeError
from livlab.kinds.picture.claims import PictureSummary, judge
from livlab.kinds.picture.colour import MeanColour, colour_routes, coordinate, lab, mean_colour
from livlab.kinds.picture.config import Colour, Illuminant, Observer
from livlab.kinds.picture.film import CameraFilm
from livlab.model.colour import ILLUMINANTS, OBSERVERS, channel_wavelengths, thesis_rgb

THREE = Colour(routes=("thesis", "stochastic", "cie"))


def test_the_files_names_of_illuminants_and_observers_are_those_that_are_known() -> None:
    assert set(get_args(Illuminant)) == set(ILLUMINANTS)
    assert set(get_args(Observer)) == set(OBSERVERS)


def test_every_route_finds_its_own_wavelengths_in_the_union() -> None:
    grid, routes = colour_routes(THREE, seed=3)
    assert np.all(np.diff(grid) > 0)
    thesis = np.sort(channel_wavelengths(20, 5).ravel())
    drawn = np.sort(channel_wavelengths(20, 5, stochastic=True, seed=3).ravel())
    assert np.allclose(grid[list(routes["thesis"].indices)], thesis)
    assert np.allclose(grid[list(routes["stochastic"].indices)], drawn)
    assert np.allclose(grid[list(routes["cie"].indices)], np.arange(400, 721, 20))
    assert len(grid) == len(np.unique(np.round(np.concatenate([thesis, drawn, np.arange(400, 721, 20)]), 6)))


def test_a_route_gives_the_colour_that_its_wavelengths_alone_would() -> None:
    grid, routes = colour_routes(THREE, seed=3)
    spectrum = xr.DataArray(np.exp(-(((grid - 620) / 80) ** 2)), dims="wavelength", coords={"wavelength": grid})
    at = spectrum.isel(wavelength=list(routes["thesis"].indices))
    assert np.allclose(routes["thesis"].rgb(spectrum), thesis_rgb(at), rtol=1e-12)
    assert np.allclose(routes["thesis"].rgb(spectrum, 2.0), 2 * thesis_rgb(at), rtol=1e-12)
    white = xr.ones_like(spectrum)
    for route in routes.values():
        assert np.allclose(route.rgb(white), 1.0, atol=1e-9)


def test_a_band_too_narrow_for_the_eye_is_refused() -> None:
    narrow = Colour.model_validate({"routes": ["cie"], "band": {"start_nm": 500.0, "stop_nm": 600.0, "step_nm": 20.0}})
    with pytest.raises(RangeError, match="luminance"):
        colour_routes(narrow, seed=1)


def test_cielab_is_that_of_colour_science() -> None:
    rgb = np.array([[0.2, 0.05, 0.03], [1.0, 1.0, 1.0], [0.02, 0.02, 0.5]])
    known = reference.XYZ_to_Lab(
        reference.RGB_to_XYZ(rgb, "sRGB", chromatic_adaptation_transform=None), np.array([0.3127, 0.3290])
    )
    # colour-science takes sRGB's matrix as IEC 61966-2-1 prints it, to four digits: white itself is off by 0.008.
    assert np.allclose(lab(rgb), known, atol=1e-2)


def film_of(samples: np.ndarray, grid: np.ndarray) -> CameraFilm:  # type: ignore[type-arg]
    """A film whose batches saw these mean spectra (batch, W)."""
    film = CameraFilm.empty(1, 1, grid)
    film.spectra, film.batches = list(samples), len(samples)
    return film


def test_the_error_of_a_mean_colour_is_the_scatter_over_pictures() -> None:
    """Over 300 pictures whose wavelengths share their noise the stated errors are the scatter seen, to a tenth."""
    grid, routes = colour_routes(Colour(kappa_nm=20.0, count=2), seed=1)
    rng = np.random.default_rng(5)
    truth = np.where(grid > 600, 0.12, 0.03)
    mixing = 0.2 * np.diag(truth) @ (0.7 * np.ones((len(grid), len(grid))) + 0.3 * np.eye(len(grid)))
    which = ("L", "a", "b", "chroma", "hue")
    found, stated = [], []
    for _ in range(300):
        film = film_of(truth + rng.normal(size=(40, len(grid))) @ mixing.T, grid)
        seen = mean_colour(film, routes["thesis"], 1.5)
        pairs = [seen.uncertain(w) for w in which]
        found.append([p[0] for p in pairs])
        stated.append([p[1] for p in pairs])
    scatter = np.std(found, axis=0, ddof=1)  # itself known to 1/√600 = 4 %
    assert np.allclose(np.mean(stated, axis=0), scatter, rtol=0.15)
    exact = coordinate(lab(1.5 * routes["thesis"].matrix @ truth), "L")
    assert np.mean(found, axis=0)[0] == pytest.approx(exact, abs=5 * scatter[0] / np.sqrt(300) + 0.02)


def test_hue_goes_round_without_a_jump() -> None:
    pink = MeanColour(np.array([0.5, 0.2, 0.273]), np.diag([0.0, 0.0, 0.02]) ** 2, np.eye(3))
    value, error = pink.uncertain("hue")  # the steps of the slope lie on both sides of 0 = 360
    assert min(value, 360 - value) < 0.1
    assert error == pytest.approx(0.02 * (0.8121 - (359.2145 - 360)) / (0.276 - 0.270), rel=0.02)
    assert coordinate(np.array([50.0, 10.0, -0.1]), "hue") > 359


CLAIMS = """
[[compared]]
name = "healthy"
tissue = { preset = "liver", state = "ex_vivo" }

[[criterion]]
metric = "hue"
reading = "thesis"
within = [15, 60]

[[criterion]]
metric = "lightness difference"
against = "healthy"
within = [2, 100]

[[criterion]]
metric = "redness difference"
reading = "measured"
against = "healthy"
within = [0, 100]

[[criterion]]
metric = "relative error"
reading = "thesis"
within = [0, 0.02]
"""


def seen(rgb: tuple[float, float, float], error: float = 1e-4, relative: float = 0.01) -> PictureSummary:
    return PictureSummary({"thesis": MeanColour(np.array(rgb), error**2 * np.eye(3), np.eye(3))}, relative, 3.0, 0.5)


def test_claims_are_judged_by_their_bounds() -> None:
    config = small(CLAIMS)
    pictures = {
        ("", "thesis"): seen((0.30, 0.10, 0.05)),
        ("", "measured"): seen((0.30, 0.10, 0.05), relative=0.5),
        ("healthy", "thesis"): seen((0.10, 0.03, 0.02)),
        ("healthy", "measured"): seen((0.29, 0.05, 0.03)),
    }
    claims = {c.criterion: c for c in judge(config, pictures)}
    assert {k: c.verdict for k, c in claims.items()} == {
        "hue thesis": "PASS",
        "lightness difference thesis vs healthy": "PASS",
        "lightness difference measured vs healthy": "PASS",
        "redness difference measured vs healthy": "FAIL",
        "relative error thesis": "PASS",
    }
    light = claims["lightness difference thesis vs healthy"]
    assert light.value == pytest.approx(
        lab(np.array([0.30, 0.10, 0.05]))[0] - lab(np.array([0.10, 0.03, 0.02]))[0], abs=0.1
    )


def test_a_claim_without_power_or_without_a_number_does_not_pass() -> None:
    config = small(CLAIMS)
    noisy = {key: seen((0.30, 0.10, 0.05), error=0.2) for key in [("", "thesis"), ("", "measured")]}
    noisy |= {("healthy", r): seen((0.10, 0.03, 0.02), error=0.2) for r in ("thesis", "measured")}
    verdicts = {c.criterion: c for c in judge(config, noisy)}
    assert verdicts["hue thesis"].verdict == "TOO CLOSE"
    assert "needs about" in verdicts["hue thesis"].note
    dark = {key: seen((float("nan"),) * 3) for key in noisy}
    assert {c.verdict for c in judge(config, dark) if "error" not in c.criterion} == {"MISSING"}
