"""Known fractions → images → fractions → table → tissue preset."""

import numpy as np
import pytest
import tifffile

from livlab.acquire.micrographs.fractions import Method, layer_table, measure_files
from livlab.acquire.micrographs.table import FIELDS, read_profile, write_table
from livlab.errors import InputError
from livlab.model.tissue.presets import load_preset

TABLE_6_1 = [(0.65, 0.051, 0.192), (0.72, 0.189, 0.110), (0.83, 0.254, 0.001), (1.0, 0.087, 0.007)]


def fibres(rng, size, fraction):
    """Straight fibres in random directions until the wanted share of pixels is covered."""
    mask = np.zeros((size, size), bool)
    y, x = np.mgrid[:size, :size]
    while mask.mean() < fraction:
        angle, place = rng.random() * np.pi, rng.random(2) * size
        across = (x - place[0]) * np.sin(angle) - (y - place[1]) * np.cos(angle)
        along = (x - place[0]) * np.cos(angle) + (y - place[1]) * np.sin(angle)
        mask |= (np.abs(across) < 1.5) & (np.abs(along) < 20)
    return mask


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    """Table 6.1 as a noisy 16-bit two-colour stack, and the shares really drawn."""
    rng = np.random.default_rng(12)
    pages, drawn = [], []
    for _, elastin, collagen in TABLE_6_1:
        masks = [fibres(rng, 256, share) for share in (elastin, collagen)]
        drawn.append([m.mean() for m in masks])
        image = np.zeros((256, 256, 3))
        image[..., 1] = 30000 * masks[0]
        image[..., 0] = image[..., 2] = 25000 * masks[1]
        noise = 500 * rng.normal(size=image.shape)  # threshold 2570 is five standard deviations off
        pages.append(np.clip(image + noise, 0, 65535).astype(np.uint16))
    path = tmp_path_factory.mktemp("stack") / "capsule.tif"
    tifffile.imwrite(path, np.stack(pages), photometric="rgb", compression="zlib")
    return path, np.array(drawn)


@pytest.mark.parametrize("threshold", [10.0, "otsu"])
def test_fractions_come_back_within_their_error(stack, threshold):
    """Five-sigma noise flips 3e-7 of the pixels: the drawn shares come back to a pixel or two.

    Otsu has no second class to find where 0.1 % of a page is fibre; those two pages are left to the fixed threshold.
    """
    path, drawn = stack
    pages = list(measure_files([path], Method(threshold=threshold)))
    found = np.array([[p.elastin.value, p.collagen.value] for p in pages])
    errors = np.array([[p.elastin.standard_error, p.collagen.standard_error] for p in pages])
    wanted = np.array([row[1:] for row in TABLE_6_1])
    clear = drawn > (0.02 if threshold == "otsu" else 0.0)
    assert np.abs(found - drawn)[clear].max() < 1e-4
    # One fibre is 120 pixels of 65536, the overshoot of the drawing: the stated error covers it.
    assert (np.abs(found - wanted)[clear] < 3 * errors[clear] + 0.002).all()
    assert (errors > 0).all()


@pytest.mark.parametrize("suffix", [".csv", ".toml"])
def test_a_preset_takes_the_table(stack, tmp_path, suffix):
    pages = list(measure_files([stack[0]], Method()))
    table = layer_table(pages, edges=[0.0, 0.65, 0.72, 0.83, 1.0])
    path = tmp_path / f"capsule{suffix}"
    write_table(path, table)
    profile = read_profile(path)
    assert [row["to"] for row in profile] == [0.65, 0.72, 0.83, 1.0]
    for k, row in enumerate(profile):
        # Rounded to the second digit of the error, so off by less than a twentieth of it.
        assert abs(row["fractions"]["elastin"] - table.elastin[k]) <= 0.05 * table.elastin_error[k] + 1e-15
        assert abs(row["fractions"]["collagen"] - table.collagen[k]) <= 0.05 * table.collagen_error[k] + 1e-15
    tissue = load_preset("liver", changes={"layers.capsule.profile": profile})
    capsule = next(layer for layer in tissue.layers if layer.name == "capsule")
    assert len(capsule.flat()) == 4
    assert capsule.flat()[0].elements["collagen"].share == profile[0]["fractions"]["collagen"]


def test_the_toml_profile_is_the_presets_own_form(stack, tmp_path):
    import tomllib

    table = layer_table(list(measure_files([stack[0]], Method())), edges=[0.0, 0.65, 0.72, 0.83, 1.0])
    write_table(tmp_path / "t.toml", table)
    written = tomllib.loads((tmp_path / "t.toml").read_text())
    assert written["profile"] == read_profile(tmp_path / "t.toml")
    assert tuple(written["sublayers"][0]) == FIELDS


@pytest.mark.parametrize(
    "text",
    [
        "",
        "depth_from,depth_to,elastin,collagen\n",
        "depth_from,depth_to,elastin\n0,1,0.1\n",
        "depth_from,depth_to,elastin,collagen\n0,1,0.1,lots\n",
        "depth_from,depth_to,elastin,collagen\n0,0.5,0.1,0.1\n0.6,1,0.1,0.1\n",
        "depth_from,depth_to,elastin,collagen\n0,0.5,0.1,0.1\n",
        "depth_from,depth_to,elastin,collagen\n0,1,0.1\n",
    ],
)
def test_a_damaged_table_is_refused(tmp_path, text):
    path = tmp_path / "t.csv"
    path.write_text(text)
    with pytest.raises(InputError, match="table"):
        read_profile(path)


def test_unwritable_and_unknown_outputs_are_refused(stack, tmp_path):
    table = layer_table(list(measure_files([stack[0]], Method()))[:1])
    with pytest.raises(InputError, match=r"\.csv or \.toml"):
        write_table(tmp_path / "t.xlsx", table)
    with pytest.raises(InputError, match="cannot be written"):
        write_table(tmp_path / "absent" / "t.csv", table)
    with pytest.raises(InputError, match="cannot be read"):
        read_profile(tmp_path / "absent.csv")
