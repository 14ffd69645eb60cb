"""The catalogue: values against published ones, interpolation, provenance, tampering."""

import csv
import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from livlab import datasets
from livlab.datasets import DatasetMeta, ReferenceUnavailable, load
from livlab.errors import DatasetError, EnvironmentProblem, InputError, RangeError

SPECTRA = {
    "haemoglobin_prahl",
    "water_segelstein1981",
    "water_hale_querry1973",
    "water_pope_fry1997",
    "lipid_vanveen2004",
    "bile_nachabe2011",
    "liver_hsi_sellner2026",
    "liver_refractive_index_giannios2016",
    "water_refractive_index_daimon2007",
}
TABLES = {
    "liver_reduced_scattering_jacques2013",
    "nunes2019_table61",
    "nunes2019_table71",
    "nunes2019_states",
    "tissue_single_facts",
}


@pytest.fixture(autouse=True)
def own_data_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("LIVLAB_DATA", str(tmp_path / "mine"))
    return tmp_path / "mine"


def test_every_dataset_is_there_and_intact() -> None:
    assert set(datasets.names()) == SPECTRA | TABLES
    assert [c for c in datasets.check_all() if not c.ok] == []
    for name in SPECTRA | TABLES:
        assert load(name).is_spectrum == (name in SPECTRA)


@pytest.mark.parametrize("name", sorted(SPECTRA | TABLES))
def test_meta_is_complete(name: str) -> None:
    meta = load(name).meta
    table = (datasets.builtin_root() / name / "table.csv").read_bytes()
    assert meta.sha256 == hashlib.sha256(table).hexdigest()
    assert meta.doi or "DOI" in meta.notes
    assert all(c.unit for c in meta.columns.values() if c.type == "number")
    assert all(len(text) > 10 for text in (meta.source, meta.title, meta.licence, meta.uncertainty.text, meta.read_in))


@pytest.mark.parametrize("isosbestic_nm", [500, 529, 545, 570, 584, 797])
def test_haemoglobin_isosbestic_points(isosbestic_nm: int) -> None:
    # Zijlstra et al. 1991 and Prahl's plot: oxy- and deoxyhaemoglobin cross there, here within the table's 2 nm step.
    blood = load("haemoglobin_prahl")
    around = np.array([isosbestic_nm - 2.0, isosbestic_nm + 2.0])
    difference = blood.interpolate("hbo2", around) - blood.interpolate("hb", around)
    assert difference[0] * difference[1] < 0


def test_haemoglobin_peaks() -> None:
    blood = load("haemoglobin_prahl")
    grid = np.arange(500.0, 700.0, 2.0)
    hbo2, hb = blood.interpolate("hbo2", grid), blood.interpolate("hb", grid)
    window = (grid > 525) & (grid < 560)
    assert grid[window][np.argmax(hbo2[window])] == pytest.approx(542, abs=2)
    assert grid[np.argmax(hbo2)] == pytest.approx(576, abs=2)
    assert grid[np.argmax(hb)] == pytest.approx(556, abs=2)
    # Whole blood, 150 g/L: 2.303 e 150/64500 (Prahl); 576 nm oxygenated is close to 300 1/cm.
    assert 2.303 * 150 / 64500 * hbo2.max() == pytest.approx(296.8, abs=1.0)


@pytest.mark.parametrize(
    ("name", "expected"),
    [("water_segelstein1981", 0.0060), ("water_hale_querry1973", 0.0060), ("water_pope_fry1997", 0.00624)],
)
def test_water_at_700_nm(name: str, expected: float) -> None:
    assert load(name).interpolate("absorption_per_cm", 700.0) == pytest.approx(expected, rel=0.03)


def test_water_tables_agree_in_the_red_only() -> None:
    tables = [load(n) for n in ("water_segelstein1981", "water_hale_querry1973", "water_pope_fry1997")]
    at_420, at_700 = (np.array([t.interpolate("absorption_per_cm", w) for t in tables]) for w in (420.0, 700.0))
    assert at_700.max() / at_700.min() < 1.05
    assert at_420.max() / at_420.min() > 2
    assert at_420.max() < 0.0025


def test_liver_index_is_the_published_formula() -> None:
    liver = load("liver_refractive_index_giannios2016")
    um = liver.wavelength_nm / 1000
    assert np.abs(liver.column("n") - (1.35910 + 0.00827 / um**2 - 0.000576 / um**4)).max() < 6e-6
    assert liver.interpolate("n", 500.0) == pytest.approx(1.3830, abs=5e-5)  # Nunes 2019, section 4.2.3


def test_water_index_is_the_published_sellmeier_formula() -> None:
    # Daimon and Masumura 2007, Table 2, 20 C.
    strength = np.array([5.684027565e-1, 1.726177391e-1, 2.086189578e-2, 1.130748688e-1])
    resonance = np.array([5.101829712e-3, 1.821153936e-2, 2.620722293e-2, 1.069792721e1])
    water = load("water_refractive_index_daimon2007")
    um2 = (water.wavelength_nm[:, None] / 1000) ** 2
    expected = np.sqrt(1 + (strength * um2 / (um2 - resonance)).sum(axis=1))
    assert np.abs(water.column("n") - expected).max() < 6e-6
    assert water.column("n") is water.column("n_daimon2007_20C")
    assert water.interpolate("n", 587.725) == pytest.approx(1.333399, abs=2e-5)  # measured, their Table 1


def test_fat_peaks_at_930_nm() -> None:
    fat = load("lipid_vanveen2004")
    assert fat.wavelength_nm[np.argmax(fat.column("absorption_per_cm"))] == pytest.approx(930, abs=2)


def test_bile_in_the_near_infrared_is_water() -> None:
    bile, water = load("bile_nachabe2011"), load("water_segelstein1981")
    grid = bile.wavelength_nm[bile.wavelength_nm > 1100]
    ratio = bile.interpolate("absorption_per_cm", grid) / water.interpolate("absorption_per_cm", grid)
    # One reading step of the figure is 4 %.
    assert np.median(ratio) == pytest.approx(1.0, abs=0.04)


def test_human_liver_shape() -> None:
    liver = load("liver_hsi_sellner2026")
    share = liver.column("human_reflectance_share")
    assert len(share) == 100
    assert share.sum() == pytest.approx(0.993, abs=5e-4)
    dips = liver.wavelength_nm[np.argmin(share)]
    assert dips == pytest.approx(576, abs=3)  # the oxyhaemoglobin peak


def test_parameter_tables() -> None:
    capsule = load("nunes2019_table61").table
    assert capsule.shape == (4, 5)
    weight = (capsule.depth_to_percent - capsule.depth_from_percent) / 100
    assert weight.sum() == pytest.approx(1)
    assert (weight * capsule.collagen_volume_fraction).sum() == pytest.approx(0.1338, abs=1e-4)
    parameters = load("nunes2019_table71").table.set_index("symbol")
    assert parameters.value["f_LA"] == 0.779
    assert parameters.value["d_collagen"] == 3.5
    assert np.isnan(parameters.value["sigma_a_bile"])
    states = load("nunes2019_states").table.set_index(["state", "symbol"])
    assert states.value["in_vivo", "R"] == 0.004
    assert load("tissue_single_facts").table.set_index("quantity").low["capsule_thickness"] == 70
    jacques = load("liver_reduced_scattering_jacques2013").table
    assert list(jacques.a_musp500_per_cm) == [9.0, 9.2, 16.5, 18.9]
    with pytest.raises(DatasetError, match="table of parameters"):
        load("nunes2019_table61").interpolate("sublayer", 500.0)
    with pytest.raises(DatasetError, match="holds text"):
        load("nunes2019_states").column("state")


def test_interpolation_is_linear_and_keeps_shape() -> None:
    fat = load("lipid_vanveen2004")
    low, high = fat.interpolate("absorption_per_cm", [600.0, 601.0])
    assert fat.interpolate("absorption_per_cm", 600.25) == pytest.approx(0.75 * low + 0.25 * high, rel=1e-12)
    assert fat.interpolate("absorption_per_cm", 600.25).shape == ()
    assert fat.interpolate("absorption_per_cm", np.full((2, 3), 600.0)).shape == (2, 3)
    assert np.array_equal(fat.interpolate("absorption_per_cm", fat.wavelength_nm), fat.column("absorption_per_cm"))
    assert fat.interpolate("absorption_per_cm", []).shape == (0,)
    assert fat.interpolate("absorption_per_cm", 600.0, unit="1/mm") == pytest.approx(float(low) / 10)
    with pytest.raises(InputError, match="cannot be given in nm"):
        fat.interpolate("absorption_per_cm", 600.0, unit="nm")
    with pytest.raises(InputError, match="not a unit livlab knows"):
        fat.interpolate("absorption_per_cm", 600.0, unit="1/furlong")


@pytest.mark.parametrize("asked", [428.9, 1098.1, float("nan"), float("inf"), [500.0, 2000.0], -1.0, 0.5])
def test_outside_the_range_is_an_error(asked: float | list[float]) -> None:
    with pytest.raises(RangeError) as caught:
        load("lipid_vanveen2004").interpolate("absorption_per_cm", asked)
    worst = asked[-1] if isinstance(asked, list) else asked
    for part in ("lipid_vanveen2004", "429 to 1098 nm", f"{worst:g} nm", "does not extrapolate"):
        assert part in str(caught.value)


def test_ends_of_the_range_bear_rounding() -> None:
    liver = load("liver_refractive_index_giannios2016")
    assert liver.interpolate("n", np.nextafter(450.0, 0)) == liver.column("n")[0]


def test_units_columns_and_text() -> None:
    bile = load("bile_nachabe2011")
    assert bile.unit("absorption_per_cm") == "1/cm"
    assert bile.unit("wavelength_nm") == "nm"
    with pytest.raises(DatasetError, match=r"no column 'absorption'.*absorption_per_cm"):
        bile.column("absorption")
    with pytest.raises(InputError, match="must be numbers"):
        bile.interpolate("absorption_per_cm", "green")


def test_what_load_returns_cannot_be_spoilt() -> None:
    bile = load("bile_nachabe2011")
    with pytest.raises(ValueError, match="read-only"):
        bile.column("absorption_per_cm")[0] = 0.0
    with pytest.raises(TypeError):
        bile.columns["absorption_per_cm"] = bile.wavelength_nm  # type: ignore[index]
    frame = bile.table
    frame.loc[0, "absorption_per_cm"] = -1.0
    assert load("bile_nachabe2011").table.absorption_per_cm[0] == 51.5068


def test_frame_citation_provenance() -> None:
    bile = load("bile_nachabe2011")
    frame = bile.to_frame()
    assert frame.index.name == "wavelength_nm"
    assert frame.attrs["units"] == {"wavelength_nm": "nm", "absorption_per_cm": "1/cm"}
    assert "10.1364/BOE.2.000600" in bile.cite()
    assert bile.bibtex()["doi"] == "10.1364/BOE.2.000600"
    assert bile.bibtex()["year"] == "2011"
    assert "doi" not in load("water_segelstein1981").bibtex()
    provenance = bile.provenance()
    assert list(provenance) == ["name", "source", "doi", "kind", "uncertainty", "licence", "sha256"]
    assert provenance["kind"] == "digitised"
    assert "350 nm" in provenance["uncertainty"]


def test_unknown_name_suggests() -> None:
    with pytest.raises(DatasetError, match="Did you mean haemoglobin_prahl"):
        load("hemoglobin_prahl")


@pytest.mark.parametrize(
    "name", ["", "..", "../bile_nachabe2011", "a/b", "a\\b", "A", "a b", ".hidden", "x" * 65, "a\0b", "a\n"]
)
def test_name_cannot_leave_the_catalogue(name: str) -> None:
    with pytest.raises(InputError, match="dataset name"):
        load(name)


def test_reference_that_is_not_to_be_had() -> None:
    assert {"nachabe2011_liver", "nunes2017_brdf", "germer1998_liver"} <= set(datasets.unavailable())
    assert not set(datasets.unavailable()) & set(datasets.names())
    for name, entry in datasets.unavailable().items():
        with pytest.raises(ReferenceUnavailable, match="reference not available") as caught:
            load(name)
        assert f"livlab data add FILE --name {name} " in caught.value.remedy
        assert entry.instead is None or entry.instead in SPECTRA | TABLES


def test_no_home_and_unreadable_folders_do_not_matter(tmp_path: Path) -> None:
    code = "import sys; from livlab import datasets; print(len(set(datasets.names()) & set(sys.argv[1:])))"
    for env in (
        {},
        {"HOME": "/nonexistent"},
        {"HOME": ""},
        {"LIVLAB_DATA": "/proc/none"},
        {"LIVLAB_DATA": "/dev/null"},
    ):
        run = subprocess.run(
            [sys.executable, "-c", code, *SPECTRA, *TABLES],
            env=env,
            capture_output=True,
            text=True,
            cwd=tmp_path,
            check=False,
        )
        assert run.returncode == 0, run.stderr
        assert run.stdout.splitlines()[0] == str(len(SPECTRA | TABLES))


def test_an_installation_without_its_datasets_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from livlab.datasets import catalogue

    monkeypatch.setattr(catalogue, "__file__", str(tmp_path / "livlab" / "datasets" / "catalogue.py"))
    with pytest.raises(EnvironmentProblem, match="Install livlab again"):
        datasets.builtin_root()


def test_loading_needs_neither_pandas_nor_matplotlib() -> None:
    code = (
        "import sys; from livlab.datasets import load; load('bile_nachabe2011').interpolate('absorption_per_cm', 500); "
        "print([m for m in ('pandas', 'matplotlib', 'drjit', 'scipy') if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_meta_round_trips_through_json() -> None:
    meta = load("haemoglobin_prahl").meta
    assert DatasetMeta.model_validate(meta.model_dump(mode="json")) == meta


def test_tables_equal_the_sheet_they_were_taken_from() -> None:
    sheets = Path(__file__).resolve().parents[4] / "shared" / "figures"
    if not sheets.is_dir():
        pytest.skip("the transcription sheet is not beside this checkout")
    known = [sheet for sheet in sorted(sheets.glob("*.csv")) if sheet.stem in datasets.names()]
    assert len(known) >= 9  # some sheets are of tables that livlab does not have yet
    for sheet in known:
        with sheet.open(newline="") as stream:
            rows = list(csv.reader(stream))
        dataset = load(sheet.stem)
        assert list(dataset.columns) == rows[0]
        for index, name in enumerate(rows[0]):
            cells = [row[index] for row in rows[1:]]
            values = dataset.columns[name]
            if isinstance(values, tuple):
                assert list(values) == cells
            else:
                assert np.array_equal(values, [float(c) if c else np.nan for c in cells], equal_nan=True)
