"""Meshes and segmentations through every file format and back."""

import nibabel
import nrrd
import numpy as np
import pytest
import tifffile
from PIL import Image

from livlab.errors import EnvironmentProblem
from livlab.model.shapes import box, check, read_mesh, read_volume, sphere, surface, write_meshes

BALL = sphere(9.0, (3.0, -2.0, 50.0), resolution_mm=2.0)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl"])
def test_meshes_come_back(tmp_path, suffix):
    path = tmp_path / f"ball{suffix}"
    write_meshes({path: BALL})
    again = read_mesh(path)
    assert len(again.faces) == len(BALL.faces)
    assert len(again.vertices) == len(BALL.vertices)
    assert check(again) == ()
    exact = {".ply": 0.0, ".obj": 0.0, ".stl": 4e-6}[suffix]
    assert np.abs(again.vertices[again.faces] - BALL.vertices[BALL.faces]).max() <= exact
    assert again.volume == pytest.approx(BALL.volume, rel=1e-6)


@pytest.mark.parametrize("suffix", [".ply", ".obj"])
def test_other_programs_read_the_normals_too(tmp_path, suffix):
    import trimesh

    path = tmp_path / f"ball{suffix}"
    write_meshes({path: BALL})
    loaded = trimesh.load_mesh(path, process=False, maintain_order=True)
    assert np.abs(np.asarray(loaded.vertex_normals) - BALL.vertex_normals).max() < 1e-6


@pytest.mark.parametrize(("unit", "factor"), [("cm", 10.0), ("m", 1000.0), ("um", 1e-3), ("inch", 25.4)])
def test_units_of_a_mesh_file(tmp_path, unit, factor):
    path = tmp_path / "ball.ply"
    write_meshes({path: BALL})
    assert read_mesh(path, unit=unit).extent == pytest.approx(factor * BALL.extent)


@pytest.mark.parametrize("form", ["ascii", "binary"])
@pytest.mark.parametrize("suffix", [".ply", ".stl"])
def test_files_of_other_programs(tmp_path, suffix, form):
    path = tmp_path / f"ball{suffix}"
    kind = {(".ply", "ascii"): {"encoding": "ascii"}, (".ply", "binary"): {"encoding": "binary"}}.get(
        (suffix, form), {}
    )
    file_type = {(".stl", "ascii"): "stl_ascii", (".stl", "binary"): "stl"}.get((suffix, form), suffix[1:])
    BALL.as_trimesh().export(path, file_type=file_type, **kind)
    again = read_mesh(path)
    assert check(again) == ()
    assert again.volume == pytest.approx(BALL.volume, rel=1e-5)


def test_an_obj_of_quads_with_texture_seams_becomes_closed(tmp_path):
    corners = [(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)]
    quads = [(1, 3, 4, 2), (5, 6, 8, 7), (1, 2, 6, 5), (3, 7, 8, 4), (1, 5, 7, 3), (2, 4, 8, 6)]
    lines = ["mtllib missing.mtl", "o cube", *(f"v {x} {y} {z}" for x, y, z in corners)]
    lines += [f"vt {k / 4} 0" for k in range(4)]
    lines += ["f " + " ".join(f"{v}/{k + 1}" for k, v in enumerate(quad)) for quad in quads]
    path = tmp_path / "cube.obj"
    path.write_text("\n".join(lines) + "\n")
    mesh = read_mesh(path)
    assert (len(mesh.vertices), len(mesh.faces)) == (8, 12)
    assert check(mesh) == ()
    assert mesh.volume == pytest.approx(1.0)


def test_what_cannot_be_written_leaves_nothing(tmp_path):
    (tmp_path / "b.ply").mkdir()
    (tmp_path / "b.ply" / "x").write_text("in the way")
    with pytest.raises(EnvironmentProblem) as caught:
        write_meshes({tmp_path / "c" / "a.ply": BALL, tmp_path / "b.ply": BALL})
    assert caught.value.remedy
    assert sorted(p.name for p in tmp_path.iterdir()) == ["b.ply"]


def ellipsoid():
    """Labels [i, j, k] with semi-axes 14, 9 and 6 mm on voxels of 1, 0.8 and 1.5 mm, about (10, 20, 30) mm."""
    spacing = np.array([1.0, 0.8, 1.5])
    shape = (36, 30, 14)
    index = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), axis=-1)
    offset = (index - (np.array(shape) - 1) / 2) * spacing
    labels = np.where((offset / [14.0, 9.0, 6.0]) ** 2 @ np.ones(3) < 1, 2, 0).astype(np.uint8)
    labels[0, 0, 0] = 7
    origin = np.array([10.0, 20.0, 30.0]) - (np.array(shape) - 1) / 2 * spacing
    return labels, spacing, origin


def expect_ellipsoid(segmentation, centre=(10.0, 20.0, 30.0), size=(28.0, 18.0, 12.0)):
    made = surface(segmentation, smoothing_mm=0.6)
    assert check(made.mesh) == ()
    assert made.mesh.bounds.mean(axis=0) == pytest.approx(centre, abs=0.1)
    assert made.mesh.extent == pytest.approx(size, abs=0.9)
    assert made.mesh.volume == pytest.approx(4 / 3 * np.pi * 14 * 9 * 6, rel=0.04)
    return made


def nifti(path, labels, affine, unit="mm"):
    image = nibabel.Nifti1Image(labels, affine)
    if unit:
        image.header.set_xyzt_units(xyz=unit)
    nibabel.save(image, path)


@pytest.mark.parametrize("name", ["liver.nii", "liver.nii.gz"])
def test_nifti_with_its_affine(tmp_path, name):
    labels, spacing, origin = ellipsoid()
    affine = np.diag([*-spacing[:2], spacing[2], 1.0])  # voxels run to the left and to the back: RAS is negative
    affine[:3, 3] = [*-origin[:2], origin[2]]
    nifti(tmp_path / name, labels, affine)
    expect_ellipsoid(read_volume(tmp_path / name, label=2))


def test_a_turned_and_mirrored_nifti_is_the_same_organ(tmp_path):
    labels, spacing, origin = ellipsoid()
    affine = np.diag([*-spacing[:2], spacing[2], 1.0])
    affine[:3, 3] = [*-origin[:2], origin[2]]
    flipped = labels[::-1].transpose(2, 0, 1)
    turn = np.zeros((4, 4))
    turn[[1, 2, 0, 3], [0, 1, 2, 3]] = 1
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    mirror[0, 3] = labels.shape[0] - 1
    nifti(tmp_path / "a.nii", flipped, affine @ mirror @ turn.T)
    made = expect_ellipsoid(read_volume(tmp_path / "a.nii", label=2))
    nifti(tmp_path / "b.nii", labels, affine)
    plain = surface(read_volume(tmp_path / "b.nii", label=2), smoothing_mm=0.6)
    assert made.mesh.volume == pytest.approx(plain.mesh.volume, rel=2e-3)


@pytest.mark.parametrize(("unit", "factor"), [("meter", 1e-3), ("micron", 1e3)])
def test_units_of_a_nifti(tmp_path, unit, factor):
    labels, spacing, origin = ellipsoid()
    affine = np.diag([*(-spacing[:2] * factor), spacing[2] * factor, 1.0])
    affine[:3, 3] = np.array([*-origin[:2], origin[2]]) * factor
    nifti(tmp_path / "a.nii", labels, affine, unit)
    expect_ellipsoid(read_volume(tmp_path / "a.nii", label=2))


def test_a_nifti_without_a_unit_says_so(tmp_path):
    labels, spacing, _ = ellipsoid()
    nifti(tmp_path / "a.nii", labels, np.diag([*spacing, 1.0]), unit=None)
    assert any("unit" in note for note in read_volume(tmp_path / "a.nii", label=2).notes)


@pytest.mark.parametrize("space", ["left-posterior-superior", "right-anterior-superior"])
def test_nrrd_with_its_axes(tmp_path, space):
    labels, spacing, origin = ellipsoid()
    sign = np.array([1, 1, 1]) if space.startswith("left") else np.array([-1, -1, 1])
    header = {"space": space, "space directions": np.diag(sign * spacing), "space origin": sign * origin}
    nrrd.write(str(tmp_path / "liver.nrrd"), labels, header)
    expect_ellipsoid(read_volume(tmp_path / "liver.nrrd", label=2))


def test_nrrd_with_spacings_alone(tmp_path):
    labels, spacing, _ = ellipsoid()
    nrrd.write(str(tmp_path / "a.nrrd"), labels, {"spacings": spacing.tolist()})
    read = read_volume(tmp_path / "a.nrrd", label=2)
    assert any("axes" in note for note in read.notes)
    expect_ellipsoid(read, centre=(np.array(labels.shape) - 1) / 2 * spacing)


@pytest.mark.parametrize("kind", ["npy", "npz", "npz with spacing", "png", "tiff"])
def test_arrays_and_image_stacks_are_z_y_x(tmp_path, kind):
    labels, spacing, _ = ellipsoid()
    volume = labels.transpose(2, 1, 0)
    path, given = tmp_path / "volume", spacing
    if kind == "npy":
        path = tmp_path / "volume.npy"
        np.save(path, volume)
    elif kind.startswith("npz"):
        path = tmp_path / "volume.npz"
        given = None if "with" in kind else spacing
        np.savez(path, labels=volume, **({"spacing_mm": spacing} if given is None else {}))
    else:
        path.mkdir()
        for k, one in enumerate(volume):  # slice 10 follows slice 9
            if kind == "png":
                Image.fromarray(one).save(path / f"slice{k}.png")
            else:
                tifffile.imwrite(path / f"slice{k}.tif", one)
    read = read_volume(path, label=2, spacing_mm=given)
    assert read.volume_mm3 == pytest.approx((labels == 2).sum() * spacing.prod())
    expect_ellipsoid(read, centre=(np.array(labels.shape) - 1) / 2 * spacing)


def test_the_surface_of_a_box_of_voxels_has_its_volume():
    inside = np.zeros((30, 30, 30), bool)
    inside[5:25, 8:22, 10:20] = True
    from livlab.model.shapes import Segmentation

    made = surface(Segmentation(inside, np.diag([0.5, 0.5, 0.5, 1.0])), smoothing_mm=0.0)
    assert made.mesh.volume == pytest.approx(10 * 7 * 5, rel=0.03)
    assert made.mesh.extent == pytest.approx([10, 7, 5], abs=1e-6)


def test_parts_are_kept_or_left_out_and_told():
    from livlab.model.shapes import Segmentation

    inside = np.zeros((40, 20, 20), bool)
    inside[3:23, 3:17, 3:17] = True
    inside[28:36, 5:13, 5:13] = True
    volume = Segmentation(inside, np.eye(4))
    largest, both = surface(volume), surface(volume, keep="all")
    assert any("left out" in note for note in largest.notes)
    assert largest.mesh.bounds[1, 0] < 25 < both.mesh.bounds[1, 0]
    assert len(check(both.mesh)) == 1


def test_a_segmentation_cut_off_by_its_volume_is_closed_and_told():
    from livlab.model.shapes import Segmentation

    made = surface(Segmentation(np.ones((12, 12, 12), bool), np.eye(4)))
    assert check(made.mesh) == ()
    assert any("cut flat" in note for note in made.notes)


def test_a_mesh_with_a_limit_of_faces():
    from livlab.model.shapes import Segmentation

    index = np.indices((50, 50, 50)) - 24.5
    ball = Segmentation((index**2).sum(axis=0) < 20**2, np.eye(4))
    made = surface(ball, faces=1500)
    assert 1000 < len(made.mesh.faces) <= 1500
    assert check(made.mesh) == ()
    assert made.mesh.volume == pytest.approx(4 / 3 * np.pi * 20**3, rel=0.02)


def test_boxes_keep_their_corners_in_every_format(tmp_path):
    files = {tmp_path / f"box{suffix}": box((1 / 3, 2 / 3, np.pi)) for suffix in (".ply", ".obj")}
    write_meshes(files)
    for path, mesh in files.items():
        assert read_mesh(path).digest == mesh.digest
