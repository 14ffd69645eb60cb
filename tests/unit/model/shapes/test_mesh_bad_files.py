"""Broken, mislabelled and oversized files are refused before they do harm."""

import gzip
import itertools
import resource
import struct

import nibabel
import numpy as np
import pytest
from PIL import Image

from livlab.errors import InputError
from livlab.model.shapes import Segmentation, check, read_mesh, read_volume, sphere, surface, write_meshes

BALL = sphere(9.0, resolution_mm=3.0)


@pytest.fixture
def files(tmp_path):
    made = {suffix: tmp_path / f"ball{suffix}" for suffix in (".ply", ".obj", ".stl")}
    write_meshes(dict.fromkeys(made.values(), BALL))
    return made


def refused(path, **options):
    with pytest.raises(InputError) as caught:
        read_mesh(path, **options)
    assert caught.value.remedy
    return caught.value.message


def refused_volume(path, **options):
    with pytest.raises(InputError) as caught:
        read_volume(path, **options)
    assert caught.value.remedy
    return caught.value.message


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl"])
@pytest.mark.parametrize("share", [0.3, 0.7, 0.99])
def test_cut_short_at_any_place_it_never_passes(files, suffix, share):
    raw = files[suffix].read_bytes()
    files[suffix].write_bytes(raw[: int(share * len(raw))])
    with pytest.raises(InputError) as caught:
        check(read_mesh(files[suffix]))
    assert caught.value.remedy


@pytest.mark.parametrize("share", [0.3, 0.99])
def test_an_ascii_stl_cut_short(tmp_path, share):
    path = tmp_path / "ball.stl"
    BALL.as_trimesh().export(path, file_type="stl_ascii")
    raw = path.read_bytes()
    path.write_bytes(raw[: int(share * len(raw))])
    assert "ends within" in refused(path)


def test_an_ascii_ply_cut_short(tmp_path):
    path = tmp_path / "ball.ply"
    BALL.as_trimesh().export(path, encoding="ascii")
    raw = path.read_bytes()
    path.write_bytes(raw[: int(0.8 * len(raw))])
    with pytest.raises(InputError):
        check(read_mesh(path))


@pytest.mark.parametrize(("real", "named"), list(itertools.permutations([".ply", ".obj", ".stl"], 2)))
def test_a_wrong_name(files, tmp_path, real, named):
    path = tmp_path / f"wrong{named}"
    path.write_bytes(files[real].read_bytes())
    assert "wrong" in refused(path)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl"])
def test_empty_files_and_noise(tmp_path, suffix):
    path = tmp_path / f"x{suffix}"
    path.write_bytes(b"")
    assert "empty" in refused(path)
    path.write_bytes(np.random.default_rng(0).bytes(5000))
    refused(path)


def test_points_without_faces(tmp_path):
    path = tmp_path / "x.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    refused(path)


def test_missing_files_unknown_formats_and_units(files, tmp_path):
    assert "must be a file" in refused(tmp_path / "no.ply")
    assert "must end in" in refused(tmp_path / "x.fbx")
    assert "must be one of" in refused(files[".ply"], unit="furlong")


def test_coordinates_that_are_not_numbers(tmp_path):
    path = tmp_path / "x.obj"
    path.write_text("v 0 0 nan\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 4 2\nf 1 3 4\nf 2 4 3\n")
    with pytest.raises(InputError, match="finite"):
        check(read_mesh(path))


def test_faces_past_the_vertices(tmp_path):
    path = tmp_path / "x.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")
    refused(path)


def large_ply(path):
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 25000000\nproperty float x\nproperty float y\n"
    header += "property float z\nelement face 50000000\nproperty list uchar int vertex_indices\nend_header\n"
    with path.open("wb") as stream:
        stream.write(header.encode())
        stream.truncate(len(header) + 25_000_000 * 12 + 50_000_000 * 13)


def large_stl(path):
    with path.open("wb") as stream:
        stream.write(b" " * 80 + struct.pack("<I", 50_000_000))
        stream.truncate(84 + 50 * 50_000_000)


@pytest.mark.parametrize(("suffix", "write"), [(".ply", large_ply), (".stl", large_stl)])
def test_fifty_million_faces_are_refused_from_the_header(tmp_path, suffix, write):
    path = tmp_path / f"large{suffix}"
    write(path)  # sparse: it takes no room
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert "50000000" in refused(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # kB


def test_faces_of_text_files_are_counted_before_they_are_read(files, tmp_path):
    assert "at most 100" in refused(files[".obj"], max_faces=100)
    path = tmp_path / "ball.stl"
    BALL.as_trimesh().export(path, file_type="stl_ascii")
    assert f"faces = {len(BALL.faces)}" in refused(path, max_faces=100)


def image(path, values, **options):
    made = nibabel.Nifti1Image(values, np.eye(4), **options)
    made.header.set_xyzt_units(xyz="mm")
    nibabel.save(made, path)


def cube(dtype=np.uint8):
    values = np.zeros((12, 12, 12), dtype)
    values[3:9, 3:9, 3:9] = 3
    return values


def test_labels_that_are_not_there(tmp_path):
    image(tmp_path / "a.nii", cube())
    message = refused_volume(tmp_path / "a.nii", label=1)
    assert "holds 0, 3" in message
    image(tmp_path / "b.nii", np.zeros((5, 5, 5), np.uint8))
    assert "empty" in refused_volume(tmp_path / "b.nii")


def test_grey_values_want_a_threshold(tmp_path):
    values = cube(np.float32) * 0.3
    image(tmp_path / "a.nii", values)
    assert "grey values" in refused_volume(tmp_path / "a.nii")
    assert read_volume(tmp_path / "a.nii", threshold=0.5).inside.sum() == 216
    assert "excludes" in refused_volume(tmp_path / "a.nii", threshold=0.5, label=1)


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_damaged_volumes(tmp_path, share):
    image(tmp_path / "a.nii.gz", np.random.default_rng(0).integers(0, 2, (20, 20, 20)).astype(np.uint8))
    raw = (tmp_path / "a.nii.gz").read_bytes()
    (tmp_path / "a.nii.gz").write_bytes(raw[: int(share * len(raw))])
    assert "cannot be read" in refused_volume(tmp_path / "a.nii.gz")
    plain = gzip.decompress(raw)
    (tmp_path / "b.nii").write_bytes(plain[: int(share * len(plain))])
    assert "cannot be read" in refused_volume(tmp_path / "b.nii")
    for name in ("c.nrrd", "c.npy", "c.npz", "c.nii"):
        (tmp_path / name).write_bytes(b"not what it says")
        assert "cannot be read" in refused_volume(tmp_path / name, spacing_mm=[1.0])


@pytest.mark.parametrize("spacing", [[0.0], [1.0, -1.0, 1.0], [1.0, 2.0], [np.nan]])
def test_spacings_that_cannot_be(tmp_path, spacing):
    np.save(tmp_path / "a.npy", cube())
    assert "voxel spacing" in refused_volume(tmp_path / "a.npy", spacing_mm=spacing)


def test_a_spacing_of_zero_in_the_header(tmp_path):
    made = nibabel.Nifti1Image(cube(), None)
    made.header["pixdim"][1:4] = [1.0, 0.0, 1.0]
    nibabel.save(made, tmp_path / "a.nii")
    assert "voxel spacing" in refused_volume(tmp_path / "a.nii")


def test_arrays_need_a_spacing_and_three_axes(tmp_path):
    np.save(tmp_path / "a.npy", cube())
    assert "not in the file" in refused_volume(tmp_path / "a.npy")
    np.save(tmp_path / "b.npy", np.ones((4, 4)))
    assert "three" in refused_volume(tmp_path / "b.npy", spacing_mm=[1.0])
    np.savez(tmp_path / "c.npz", a=cube(), b=cube())
    assert "one array" in refused_volume(tmp_path / "c.npz", spacing_mm=[1.0])
    np.save(tmp_path / "d.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    assert "cannot be read" in refused_volume(tmp_path / "d.npy", spacing_mm=[1.0])
    image(tmp_path / "e.nii", np.ones((4, 4, 4, 3), np.uint8))
    assert "three axes" in refused_volume(tmp_path / "e.nii")


def test_a_volume_too_large_is_refused_from_its_header(tmp_path):
    with (tmp_path / "a.npy").open("wb") as stream:
        np.lib.format.write_array_header_1_0(
            stream, {"descr": "|u1", "fortran_order": False, "shape": (2000, 2000, 2000)}
        )
        stream.truncate(stream.tell() + 8_000_000_000)
    assert "at most" in refused_volume(tmp_path / "a.npy", spacing_mm=[1.0])


def test_folders_of_images_that_are_no_stack(tmp_path):
    assert "must exist" in refused_volume(tmp_path / "nowhere")
    assert "holds 0" in refused_volume(tmp_path, spacing_mm=[1.0])
    for k, size in enumerate([(8, 8), (8, 8), (8, 9)]):
        Image.fromarray(np.ones(size, np.uint8)).save(tmp_path / f"s{k}.png")
    message = refused_volume(tmp_path, spacing_mm=[1.0])
    assert "s2.png" in message
    assert "9×8" in message
    Image.fromarray(np.full((8, 8, 3), [1, 2, 3], np.uint8)).save(tmp_path / "s2.png")
    assert "colour" in refused_volume(tmp_path, spacing_mm=[1.0])
    (tmp_path / "s2.png").write_bytes(b"\x89PNG torn")
    assert "cannot be read" in refused_volume(tmp_path, spacing_mm=[1.0])


def test_a_part_too_thin_for_the_blur():
    thin = np.zeros((20, 20, 20), bool)
    thin[10, 3:17, 3:17] = True
    with pytest.raises(InputError, match="leaves nothing") as caught:
        surface(Segmentation(thin, np.eye(4)), smoothing_mm=2.0)
    assert "Smooth less" in caught.value.remedy
