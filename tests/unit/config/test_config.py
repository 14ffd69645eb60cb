"""Experiment files that do not fit, and what the user is told."""

# ruff: noqa: E501

from __future__ import annotations

import json
import os
import re
import tomllib
from pathlib import Path

import pytest

from livlab.config import KINDS, LARGEST_BYTES, json_schema, load_experiment, parse_experiment, to_toml
from livlab.errors import ConfigError
from livlab.kinds.spectral.config import SpectralExperiment
from livlab.runs.identity import canonical

ROOT = Path(__file__).resolve().parents[3]

GOOD = """\
schema = 1
kind = "spectral"
name = "small"
readings = ["thesis"]

[tissue]
preset = "liver"

[tissue.set]
"layers.parenchyma.elements.blood.fraction" = 0.05

[wavelengths]
start_nm = 500
stop_nm = 720
step_nm = 20

[instrument]
kind = "collinear"

[solver]
kind = "adding-doubling"

[[reading]]
base = "thesis"
name = "plain cosine"
redirect_factor = "cos"

[[reference]]
label = "human liver"
dataset = "liver_hsi_sellner2026"
column = "human_reflectance_share"

[[criterion]]
metric = "pearson"
against = "human liver"
reference = 1.0
tolerance = 0.01
"""


def parsed(text: str) -> SpectralExperiment:
    found = parse_experiment(text, source="a.toml")
    assert isinstance(found, SpectralExperiment)
    return found


def told(text: str) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        parse_experiment(text, source="a.toml")
    return caught.value


def test_a_good_file_is_read() -> None:
    found = parsed(GOOD)
    assert [r.name for r in found.all_readings] == ["thesis", "plain cosine"]
    assert found.wavelengths.grid().tolist() == list(range(500, 721, 20))
    assert [name for _, _, name in found.claims()] == [
        "pearson thesis vs human liver 500-720",
        "pearson plain cosine vs human liver 500-720",
    ]


@pytest.mark.parametrize(
    ("old", "new", "message", "remedy"),
    [
        ('name = "small"', 'nam = "small"', r"line 3: nam = 'small': unknown key\. Did you mean 'name'\?", ""),
        ("step_nm = 20", "step_nm = 20\nstop = 3", r"line 16: wavelengths\.stop = 3: unknown key", "stop_nm"),
        ('preset = "liver"', 'preset = "livver"', r"preset = 'livver': must be one of", "Did you mean 'liver'?"),
        ("parenchyma.elements.blood.fraction", "parenchima.elements.blood.fraction", "parenchima", "parenchyma"),
        ("blood.fraction", "blood.fractoin", "fractoin = 0.05: unknown key", "Did you mean 'fraction'?"),
        ("fraction\" = 0.05", "fraction\" = -0.05", r"fraction = -0\.05: must be greater than or equal to 0", "at least 0"),
        ("fraction\" = 0.05", "fraction\" = 1.05", r"fraction = 1\.05: must be less than or equal to 1", "at most 1"),
        ("fraction\" = 0.05", "fraction\" = 0.9", r"must sum to at most 1 .*blood 0\.9", "Lower a fraction"),
        ("fraction\" = 0.05", "fraction\" = nan", "must be a finite number", "finite"),
        ("start_nm = 500", "start_nm = -500", r"line 13: wavelengths\.start_nm = -500: must be greater than 0", "more"),
        ("stop_nm = 720", "stop_nm = 490", r"line 14: wavelengths\.stop_nm = 490(\.0)?: must be above start_nm = 500", "Raise it"),
        ("step_nm = 20", "step_nm = 30", r"step_nm = 30(\.0)?: must divide the band", "another step"),
        ("step_nm = 20", "step_nm = 1e-3", r"makes more than 10000 wavelengths", "larger step"),
        ("step_nm = 20", "", r"needs start_nm, stop_nm and step_nm, or list_nm alone", "one of the two"),
        ("step_nm = 20", "step_nm = 20\nlist_nm = [500]", r"or list_nm alone", "one of the two"),
        ('kind = "collinear"', 'kind = "colinear"', r"instrument\.kind = 'colinear'", "Did you mean 'collinear'?"),
        ('kind = "collinear"', 'kind = "collinear"\nacceptance_deg = 91', r"acceptance_deg = 91: must be less", "most 90"),
        ('kind = "adding-doubling"', 'kind = "walk"\nsamples = 5000\nrelative = 0.1', "only one of them can rule", "Drop"),
        ('kind = "adding-doubling"', 'kind = "walk"\nseed = 3', r"solver\.seed = 3", "Set `seed` at the top"),
        ('readings = ["thesis"]', 'readings = ["theses"]', r"readings\[0\] = 'theses': must be one of", "Did you mean 'thesis'"),
        ('readings = ["thesis"]', "seed = -1", r"seed = -1: must be greater than or equal to 0", "at least 0"),
        ('readings = ["thesis"]', "seed = 1.5", r"seed = 1\.5: must be a valid integer", "Give an int"),
        ('name = "plain cosine"', 'name = "thesis"', r"reading = 'thesis': appears twice", "its own name"),
        ('redirect_factor = "cos"', 'redirect_factor = "cosine"', r"reading\[0\]\.redirect_factor = 'cosine'", "Did you mean 'cos'"),
        ('redirect_factor = "cos"', 'redirect = "cos"', r"reading\[0\]\.redirect = 'cos': unknown key", "redirect_factor"),
        ('against = "human liver"', 'against = "human livr"', r"line 35: criterion\[0\]\.against = 'human livr'", "human liver"),
        ('against = "human liver"', "", "pearson needs the label of a reference", "Give it"),
        ("tolerance = 0.01", "tolerance = -0.01", r"criterion\[0\]\.tolerance = -0\.01", "at least 0"),
        ("tolerance = 0.01", 'tolerance = 0.01\nreading = "other"', r"criterion\[0\]\.reading = 'other'", "Known: all, thesis"),
        ("tolerance = 0.01", "tolerance = 0.01\nband_nm = [400, 600]", r"criterion\[0\]\.band_nm = .*within 500–720 nm", "Narrow"),
        ("tolerance = 0.01", "tolerance = 0.01\nband_nm = [600, 600]", r"criterion\[0\]\.band_nm = .*must rise", "[first, last]"),
        ("[solver]", "[processing]\ninterpolate_nm = 7\n[solver]", r"processing\.interpolate_nm = 7(\.0)?: must divide", "Change"),
        ("[solver]", "[processing]\ninterpolate_nm = 0.01\n[solver]", r"more than 2000 points", "larger step"),
        ("[solver]", "[processing]\nmoving_average = 46\n[solver]", r"moving_average = 46: must be at most 45", "Narrow"),
        ('name = "plain cosine"', 'name = "two\\nlines"', r"reading name = 'two\\nlines': must be one line", "Rename"),
        ('metric = "pearson"', 'metric = "person"', r"criterion\[0\]\.metric = 'person'", "Did you mean 'pearson'?"),
        ('name = "small"', 'name = "../small"', r"name = '\.\./small'", "no '/' or leading dot"),
        ('name = "small"', 'name = "..\\\\small"', r"name = ", "Use letters"),
        ('name = "small"', 'name = ""', r"name = ''", "Use letters"),
        ('name = "small"', "", "name: the key is missing", "Add it"),
        ("schema = 1\n", "", "schema: the key is missing", "Begin the file with the line `schema = 1`"),
        ("schema = 1\n", "schema = 2\n", r"schema = 2: this livlab reads 1", "Update livlab"),
        ("schema = 1\n", 'schema = "1"\n', r"schema = '1': this livlab reads 1", "Write `schema = 1`"),
        ('kind = "spectral"', 'kind = "spectrl"', r"kind = 'spectrl': must be one of [a-z, ]+spectral", "Did you mean 'spectral'?"),
        ('kind = "spectral"', "kind = [1]", r"kind = \[1\]: must be one of", "Pick one"),
        ("[solver]", "[solver", r"line 20, column \d+: not TOML", "Mend the line"),
        ('name = "small"', "name = small", r"line 3, column \d+: not TOML: .*, in: name = small", "quotes"),
        ('name = "small"', 'name = "a"\nname = "b"', r"line 4, column \d+: not TOML: Cannot overwrite", "Mend"),
        ('readings = ["thesis"]', 'readings = "thesis"', r"readings = 'thesis': must be a valid tuple", "Give"),
        ("[wavelengths]", "[[wavelengths]]", r"wavelengths = \[.*\]: must be a", "Give"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_told_with_path_value_bound_and_remedy(
    old: str, new: str, message: str, remedy: str
) -> None:
    assert old in GOOD
    error = told(GOOD.replace(old, new, 1))
    whole = f"{error.message} {error.remedy}"
    assert whole.startswith("a.toml")
    assert re.search(message, whole, re.DOTALL), whole
    assert remedy in whole


def test_no_reading_at_all_is_told() -> None:
    text = GOOD.replace('readings = ["thesis"]\n', "").replace(
        '[[reading]]\nbase = "thesis"\nname = "plain cosine"\nredirect_factor = "cos"\n', ""
    )
    assert "at least one reading is needed" in told(text).message


def test_a_file_nested_too_deeply_is_told() -> None:
    error = told("schema = 1\na = " + "[" * 100_000 + "]" * 100_000)
    assert "too deeply" in error.message or "not TOML" in error.message


@pytest.mark.parametrize(
    ("prepare", "message", "remedy"),
    [
        (lambda p: p.mkdir(), "is a directory", "Name an experiment file"),
        (lambda p: p.write_bytes(b"schema = 1\n\xff\xfe"), r"line 2: byte 0xff is not UTF-8", "Save the file as UTF-8"),
        (lambda p: p.write_bytes(b"# " + b"x" * LARGEST_BYTES), "MiB, more than an experiment file's", "livlab data add"),
        (lambda p: (p.parent / "smalll.toml").write_text(""), "no such file", "Did you mean 'smalll.toml'?"),
        (lambda p: None, "no such file", "Name an experiment file"),
        (os.mkfifo, "is not a regular file", "Name an experiment file"),
    ],
)  # fmt: skip
def test_a_file_that_cannot_be_read_is_told(prepare: object, message: str, remedy: str, tmp_path: Path) -> None:
    path = tmp_path / "small.toml"
    prepare(path)  # type: ignore[operator]
    with pytest.raises(ConfigError, match=message) as caught:
        load_experiment(path)
    assert str(path) in caught.value.message
    assert remedy in caught.value.remedy


def test_an_experiment_of_livlabs_own_is_found_by_its_name_and_a_file_comes_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert load_experiment("spectral").name == "spectral"
    with pytest.raises(ConfigError) as caught:
        load_experiment("spectrl")
    assert caught.value.remedy == "Did you mean 'spectral'?"
    Path("spectral").write_text(GOOD)
    assert load_experiment("spectral").name == "small"


def test_windows_line_ends_and_a_byte_order_mark_are_read(tmp_path: Path) -> None:
    path = tmp_path / "small.toml"
    path.write_bytes(b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode())
    assert load_experiment(path) == parsed(GOOD)


def test_the_resolved_file_says_every_number_and_means_the_same() -> None:
    config = parsed(GOOD)
    text = to_toml(config.resolve())
    data = tomllib.loads(text)
    assert data["instrument"]["sample_side_mm"] == 10.0
    assert data["instrument"]["acceptance_deg"] == 30.0
    assert data["processing"] == {
        "interpolate_nm": 5.0, "moving_average": 4, "alignment": "centred", "normalise": "max",
    }  # fmt: skip
    parenchyma = data["tissue"]["inline"]["layers"][1]
    assert parenchyma["elements"]["blood"]["fraction"] == 0.05
    assert parenchyma["elements"]["blood"]["oxygenation"] == 0.08
    assert data["reading"][1]["redirect_factor"] == "cos"
    assert data["reading"][1]["hepatocyte_rate"] == "log10"
    again = parsed(text)
    assert again.resolve() == config.resolve()
    assert canonical(again) == canonical(config)


def test_what_is_written_out_and_what_is_left_out_have_one_digest() -> None:
    more = GOOD.replace('kind = "collinear"', 'kind = "collinear"\nbeam = "face"\nsample_side_mm = 10').replace(
        "start_nm = 500", "start_nm = 500.0"
    )
    assert canonical(parsed(more)) == canonical(parsed(GOOD))
    other = GOOD.replace('kind = "collinear"', 'kind = "collinear"\nsample_side_mm = 11')
    assert canonical(parsed(other)) != canonical(parsed(GOOD))


def test_the_json_schema_knows_every_section_and_says_what_they_mean() -> None:
    whole = json_schema()
    kinds = {ref["$ref"].rpartition("/")[2] for ref in whole["anyOf"]}
    assert kinds == {kind.load_config().__name__ for kind in KINDS.values()}
    assert {"SpectralExperiment", "PictureExperiment", "OpticsExperiment"} <= kinds
    for kind in kinds:
        schema = whole["$defs"][kind]
        properties = schema["properties"]
        assert schema["additionalProperties"] is False
        undescribed = [k for k, v in properties.items() if not v.get("description") and k != "kind"]
        assert undescribed == []
    spectral = whole["$defs"]["SpectralExperiment"]["properties"]
    assert {"schema", "name", "tissue", "wavelengths", "instrument", "solver", "reading", "criterion"} <= set(spectral)
    assert set(tomllib.loads(GOOD)) <= set(spectral)
    broken = [ref for ref in re.findall(r'"#/\$defs/([^"]+)"', json.dumps(whole)) if ref not in whole["$defs"]]
    assert broken == []


@pytest.mark.parametrize("path", sorted((ROOT / "experiments").glob("*.toml")), ids=lambda p: p.name)
def test_every_experiment_of_the_project_is_read_and_resolves(path: Path) -> None:
    config = load_experiment(path)
    assert config.name == path.stem
    assert parse_experiment(to_toml(config.resolve())).resolve() == config.resolve()
