"""What fuzzing and thought found: files that hung a reader, filled the memory, or led it out of its folder."""

from __future__ import annotations

import gzip
import io
import json
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from livlab.brdf.files.formats import read_brdf
from livlab.config import load_experiment, parse_experiment
from livlab.core.toml_text import parse_toml
from livlab.criteria import read_claims
from livlab.errors import ConfigError, DatasetError, InputError, LivlabError
from livlab.model.shapes import read_mesh, read_volume
from livlab.model.tissue.presets import read_preset

HEAD = 'schema = 1\nkind = "spectral"\nname = "a"\n'


def refused(call: object, *given: object, **named: object) -> str:
    with pytest.raises(LivlabError) as caught:
        call(*given, **named)  # type: ignore[operator]
    assert caught.value.remedy
    return caught.value.message


@pytest.mark.parametrize(
    "line",
    [
        "seed = " + "9" * 5000,
        "seed = 0x" + "f" * 5000,
        f"seed = {2**63}",
        "x = " + "[" * 3000,
        "a" + ".a" * 3000 + " = 1",
    ],
)
def test_toml_that_python_cannot_take_is_not_toml(line: str, tmp_path: Path) -> None:
    assert "not TOML" in refused(parse_experiment, HEAD + line + "\n")
    (tmp_path / "x.toml").write_text(line)
    assert "not TOML" in refused(read_preset, tmp_path / "x.toml")
    assert parse_toml(f"a = {2**63 - 1}") == {"a": 2**63 - 1}


@pytest.mark.parametrize("name", ["x.toml", "x.csv", "x.alta", "x.bsdf", "x.binary", "x.nc"])
def test_a_pipe_is_not_waited_for(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / name)
    assert "file" in refused(read_preset if name == "x.toml" else read_brdf, tmp_path / name)


def test_a_picture_that_is_a_device_is_not_hashed_for_ever() -> None:
    text = HEAD.replace("spectral", "picture") + '[body]\nkind = "mesh"\npath = "/dev/zero"\n'
    from livlab.kinds.picture.config_scene import FileSpec

    assert "plain file" in refused(FileSpec(path="/dev/zero").resolve)
    assert refused(parse_experiment, text)


def test_an_alta_header_does_not_order_a_million_million_channels(tmp_path: Path) -> None:
    (tmp_path / "x.alta").write_text(
        "#DIM 3 1000000000000\n#PARAM_IN RUSIN_TH_TD_PD\n#PARAM_OUT INV_STERADIAN\n1 1 1 1\n"
    )
    assert "#DIM" in refused(read_brdf, tmp_path / "x.alta")


def test_numbers_of_other_scripts_are_not_numbers_of_a_header(tmp_path: Path) -> None:
    head = "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    for count in ("²", "9" * 5000, "-3"):
        (tmp_path / "x.ply").write_bytes(head.format(count).encode("latin-1"))
        assert "header" in refused(read_mesh, tmp_path / "x.ply")
    (tmp_path / "x.alta").write_text("#DIM 3 ١\n#PARAM_IN RUSIN_TH_TD_PD\n#PARAM_OUT INV_STERADIAN\n0 0 0 1\n")
    assert "#DIM" in refused(read_brdf, tmp_path / "x.alta")


def nrrd(path: Path, lines: str, content: bytes = b"") -> Path:
    path.write_bytes(b"NRRD0004\ntype: uint8\ndimension: 3\nspacings: 1 1 1\n" + lines.encode() + b"\n\n" + content)
    return path


def test_an_nrrd_skips_no_lines_for_ever_and_unpacks_no_bomb(tmp_path: Path) -> None:
    skip = nrrd(tmp_path / "a.nrrd", "sizes: 2 2 2\nencoding: raw\nline skip: 100000000000", bytes(8))
    assert "cannot be read" in refused(read_volume, skip)
    bomb = nrrd(tmp_path / "b.nrrd", "sizes: 2 2 2\nencoding: gzip", gzip.compress(bytes(1 << 24)))
    assert "cannot be read" in refused(read_volume, bomb)
    huge = nrrd(tmp_path / "c.nrrd", "sizes: 10000 10000 10000\nencoding: raw", bytes(8))
    assert "voxels" in refused(read_volume, huge)


@pytest.mark.parametrize("name", ["/etc/hostname", "../x.raw", "link.raw"])
def test_an_nrrd_takes_its_data_from_beside_itself_only(name: str, tmp_path: Path) -> None:
    (tmp_path / "x.raw").write_bytes(bytes([0, 0, 0, 1, 1, 0, 0, 0]))
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "link.raw").symlink_to(tmp_path / "x.raw")
    asked = nrrd(tmp_path / "in" / "a.nhdr", f"sizes: 2 2 2\nencoding: raw\ndata file: {name}")
    assert "beside" in refused(read_volume, asked)
    own = nrrd(tmp_path / "a.nhdr", "sizes: 2 2 2\nencoding: raw\ndata file: x.raw")
    assert read_volume(own).inside.sum() == 2


def test_a_header_does_not_claim_what_its_file_cannot_hold(tmp_path: Path) -> None:
    import nibabel

    image = nibabel.Nifti1Image(np.zeros((4, 4, 4), np.uint8), np.eye(4))
    raw = bytearray(image.to_bytes())
    raw[42:48] = np.array([900, 900, 900], "<i2").tobytes()
    (tmp_path / "a.nii").write_bytes(bytes(raw))
    (tmp_path / "b.nii.gz").write_bytes(gzip.compress(bytes(raw)))
    for name in ("a.nii", "b.nii.gz"):
        assert "claims" in refused(read_volume, tmp_path / name)


def test_an_npz_that_unpacks_beyond_any_volume_is_refused_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from livlab.model.shapes import volume_files

    np.savez_compressed(tmp_path / "a.npz", values=np.zeros((100, 100, 100)))
    monkeypatch.setattr(volume_files, "MAX_BYTES", 1 << 20)
    assert "unpack" in refused(read_volume, tmp_path / "a.npz", spacing_mm=(1.0,))


def test_arrays_of_objects_are_not_unpickled(tmp_path: Path) -> None:
    class Bomb:
        def __reduce__(self) -> object:
            return (Path.touch, (tmp_path / "executed",))

    np.save(tmp_path / "a.npy", np.array([Bomb()], dtype=object), allow_pickle=True)
    np.savez(tmp_path / "a.npz", values=np.array([Bomb()], dtype=object))
    for name in ("a.npy", "a.npz"):
        assert "cannot be read" in refused(read_volume, tmp_path / name, spacing_mm=(1.0,))
    assert not (tmp_path / "executed").exists()


def test_a_small_netcdf_does_not_claim_a_large_array(tmp_path: Path) -> None:
    import h5netcdf

    with h5netcdf.File(tmp_path / "a.nc", "w") as file:
        file.dimensions = {"sample": 10**11}
        file.create_variable("value", ("sample",), "f8", chunks=(1024,))
    assert (tmp_path / "a.nc").stat().st_size < 1 << 16
    assert "claims" in refused(read_brdf, tmp_path / "a.nc")


def test_postscript_is_no_photograph(tmp_path: Path) -> None:
    from livlab.acquire.micrographs.files import read_pages
    from livlab.acquire.photographs.read import read_photograph

    Image.new("RGB", (8, 8)).save(tmp_path / "a.eps")
    (tmp_path / "a.eps").rename(tmp_path / "a.png")
    assert "no image" in refused(read_photograph, tmp_path / "a.png")
    assert "no image" in refused(lambda: list(read_pages(tmp_path / "a.png")))


@pytest.mark.parametrize("kind", ["../../evil", "/x/evil", "Evil", "a.b", 3])
def test_a_material_cannot_name_a_library_by_its_path(kind: object) -> None:
    from livlab.kinds.brdf.config import MaterialSpec

    assert "plain name" in refused_section(
        {"name": "m", "bsdf": {"type": "twosided", "in": {"type": kind}}}, MaterialSpec
    )


def refused_section(data: dict[str, object], model: type) -> str:
    with pytest.raises(ValueError, match="plain name") as caught:
        model(**data)
    return str(caught.value)


def test_an_obj_opens_no_other_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "x.mtl")  # opening it would wait for ever
    (tmp_path / "x.obj").write_text("mtllib x.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert len(read_mesh(tmp_path / "x.obj").faces) == 1
    head = "ply\nformat ascii 1.0\ncomment TextureFile x.mtl\nelement vertex 3\nproperty float x\nproperty float y\n"
    head += "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "x.ply").write_text(head + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    assert len(read_mesh(tmp_path / "x.ply").faces) == 1


def test_directions_of_a_brdf_table_keep_their_remedy(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("wi_x,wi_y,wi_z,wo_x,wo_y,wo_z,value_L,light\n0,0,2,0,0,1,0.5,0\n")
    assert "unit" in refused(read_brdf, tmp_path / "a.csv")
    (tmp_path / "a.csv").write_text("wi_x,wi_y,wi_z,wo_x,wo_y,wo_z,value_L,light\n0,0,1,0,0,1,0.5,nan\n")
    assert "light" in refused(read_brdf, tmp_path / "a.csv")


@pytest.mark.parametrize("notes", ["[]", "[" * 5000, '{"a": 1}'])
def test_claims_that_are_no_text(tmp_path: Path, notes: str) -> None:
    (tmp_path / "claims.csv").write_bytes(b"crite\x8eon\n")
    (tmp_path / "claims.notes.json").write_text(notes)
    assert refused(read_claims, tmp_path / "claims.csv")


def test_a_name_that_leaves_the_folder_is_no_name() -> None:
    for name in ("../../x", "a/b", "..", ".hidden", "a\0b", "x" * 65, ""):
        with pytest.raises(ConfigError, match="name"):
            parse_experiment(HEAD.replace('"a"', json.dumps(name)))


def test_paths_of_a_rig_that_are_none() -> None:
    from livlab.acquire.photographs.rig_file import within

    for name in (".", "a\0b", "./.."):
        assert "rig path" in refused(within, Path(), name)


def test_links_in_a_ring_are_told(tmp_path: Path) -> None:
    from livlab.acquire.photographs.rig_file import within

    (tmp_path / "a").symlink_to(tmp_path / "b")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    assert refused(lambda: load_experiment(tmp_path / "a"))
    try:
        found = within(tmp_path, "a")
    except InputError as error:
        assert error.remedy
    else:
        assert not found.is_file()


def test_a_dataset_with_a_pipe_for_its_meta_is_told(tmp_path: Path) -> None:
    from livlab.datasets.meta import read_meta

    os.mkfifo(tmp_path / "meta.toml")
    with pytest.raises(DatasetError, match="plain file"):
        read_meta(tmp_path / "meta.toml")


@pytest.mark.parametrize("name", ["[/]", "[bold]x[/nothing]", "[link=file:x]a", "back\\\\[/]"])
def test_brackets_in_a_name_are_no_markup_of_the_terminal(name: str) -> None:
    from rich.console import Console

    from livlab.cli.progress import BarProgress, bars
    from livlab.cli.run import _print_claims

    console = Console(record=True, width=200, force_terminal=True, file=io.StringIO())
    claim = dict.fromkeys(("value", "standard_error", "reference", "tolerance"), "1.0")
    _print_claims(console, [{**claim, "criterion": name, "verdict": "PASS"}])
    narrow = Console(record=True, width=30, force_terminal=True, file=io.StringIO())
    _print_claims(narrow, [{**claim, "criterion": name, "verdict": "PASS"}])
    assert name in narrow.export_text(clear=False)
    with bars(console) as drawn:
        watcher = BarProgress(drawn, name)
        watcher.begin([name])
        watcher.advance(name, 1.0, name)
        watcher.say(name)
    assert console.export_text(clear=False).count(name) >= 4


@pytest.mark.parametrize(
    "row",
    [
        {"value": 10**400},
        {"value": 1e999},
        {"value": [0.5]},
        {"parameter": "kd[[["},
        [],
    ],
)
def test_a_fit_whose_numbers_are_none_is_no_fit(row: object, tmp_path: Path) -> None:
    from livlab.brdf.files.fitted import read_fit

    whole = {"parameter": "kd", "channel": "", "value": 0.5}
    given = {**whole, **row} if isinstance(row, dict) else row
    for rows, named in ((given, tmp_path / "bad.json"), (whole, tmp_path / "good.json")):
        named.write_text(json.dumps({"model": "lambert", "parameters": [rows]}))
    assert read_fit(tmp_path / "good.json").channels == ("value",)
    assert "bad.json" in refused(read_fit, tmp_path / "bad.json")
