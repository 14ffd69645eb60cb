"""Insets, sections, thinning and the distance field: what they refuse and what they promise."""

import numpy as np
import pytest

from livlab.errors import InputError
from livlab.model.shapes import (
    Plane,
    TriangleMesh,
    box,
    cache,
    check,
    creased,
    distance_field,
    inset,
    liver,
    section,
    sphere,
    wedge,
)
from livlab.model.shapes.solids import thinned

BALL = sphere(10.0, resolution_mm=1.0)


@pytest.fixture
def cache_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(cache.platformdirs, "user_cache_dir", lambda _: str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_a_box_inset_by_distance_keeps_its_depth_and_is_thicker_at_the_corners():
    shell = inset(box((12.0, 10.0, 8.0)), 1.0, spacing_mm=0.25)
    assert shell.mesh.extent == pytest.approx([10.0, 8.0, 6.0], abs=0.02)
    assert shell.mesh.volume == pytest.approx(480.0, rel=0.01)
    assert shell.depth.outside_share < 0.01
    assert np.sqrt(3) - 0.01 < shell.thickness.maximum_mm < np.sqrt(3) + 0.25  # the grid rounds the corner


def test_scaling_is_uneven_where_the_shape_is_and_says_so():
    """Faces of a box at 3, 5 and 10 mm from the centre move by shares of these."""
    shell = inset(box((20.0, 10.0, 6.0)), 0.3, "scale")
    factor = 1 - 0.3 * 760 / (3 * 1200)
    assert shell.depth.minimum_mm == pytest.approx(3 * (1 - factor), rel=1e-9)
    assert shell.depth.outside_share == pytest.approx((2 * 200 + 2 * 60) / 760, abs=0.01)  # all but the middle pair
    assert shell.mesh.volume == pytest.approx(1200 * factor**3, rel=1e-9)


def test_scaling_pierces_a_hollow_shape_and_is_refused_with_the_place():
    hollow = section(box((20.0, 20.0, 10.0)), planes=wedge((0, 0, -2), (0, 1, 0), (0, 0, 1), 1.0)).outer
    with pytest.raises(InputError, match="must not pierce") as caught:
        inset(hollow, 1.0, "scale")
    assert "mm" in caught.value.message
    assert inset(hollow, 1.0, spacing_mm=0.25).depth.outside_share < 0.02


def test_moving_along_normals_crosses_itself_where_the_shell_is_too_thick():
    with pytest.raises(InputError, match="must not cross itself"):
        inset(liver(resolution_mm=2.0, cached=False), 6.0, "normal")


@pytest.mark.parametrize("how", ["distance", "normal", "scale"])
def test_a_shell_that_leaves_nothing_is_refused(how):
    with pytest.raises(InputError, match="leaves nothing"):
        inset(BALL, 11.0, how)


@pytest.mark.parametrize(("thickness", "how"), [(0.0, "distance"), (np.nan, "distance"), (1.0, "melt")])
def test_requests_that_make_no_sense(thickness, how):
    with pytest.raises(InputError):
        inset(BALL, thickness, how)


def test_a_section_leaves_capsule_around_parenchyma_on_the_cut():
    shell = inset(BALL, 1.0, spacing_mm=0.5)
    cut = section(BALL, shell.mesh, planes=Plane((0, 0, 2.0), (0, 0, 1)), gap_mm=0.01)
    assert check(cut.outer, cut.inner) == ()
    assert cut.outer.bounds[1, 2] == pytest.approx(2.0, abs=1e-9)
    assert cut.inner.bounds[1, 2] == pytest.approx(1.99, abs=1e-9)
    caps = []
    for mesh, height in ((cut.outer, 2.0), (cut.inner, 1.99)):
        on = (np.abs(mesh.vertices[mesh.faces][:, :, 2] - height) < 1e-6).all(axis=1)
        caps.append(mesh.face_areas[on].sum())
    assert caps[0] - caps[1] == pytest.approx(np.pi * (100 - 81), rel=0.02)  # a ring 1 mm wide, seen askew


def test_a_wedge_and_a_corner_of_nested_spheres_stay_closed():
    inner = BALL.scaled(0.9)
    for planes in (
        wedge((0, 0, 0), (0, 0, 1), (0, -1, 0), 1.2),
        [Plane((0, 0, 0), n) for n in ((1, 0, 0), (0, -1, 0), (0, 0, 1))],
    ):
        cut = section(BALL, inner, planes=planes)
        assert check(cut.outer, cut.inner) == ()
        assert cut.removed_mm3 == pytest.approx(BALL.volume - cut.outer.volume)


def test_many_cuts_through_a_liver_are_sound():
    """Planes on vertices, next to vertices and anywhere."""
    organ = liver(resolution_mm=3.0, cached=False)
    inner = inset(organ, 2.0, spacing_mm=2.0).mesh
    draw = np.random.default_rng(5)
    for k in range(12):
        point = organ.vertices[draw.integers(len(organ.vertices))] * (0.2 if k % 3 else 0.9)
        if k % 4 == 1:
            point = organ.vertices[np.abs(organ.vertices[:, 1]).argmin()] + 1e-7
        normal = np.eye(3)[k % 3] if k % 2 else draw.normal(size=3)
        planes = Plane(tuple(point), tuple(normal)) if k < 8 else wedge(point, normal, draw.normal(size=3), 1.0)
        cut = section(organ, inner, planes=planes)
        assert all("separate" in said for said in check(cut.outer, cut.inner))


def test_creases_shade_a_cap_flat_and_leave_the_rest_round():
    cut = section(BALL, planes=Plane((0, 0, 3.0), (0, 0, 1))).outer
    shaded = creased(cut)
    cap = np.abs(shaded.vertices[shaded.faces][:, :, 2] - 3.0).max(axis=1) < 1e-9
    assert shaded.vertex_normals[shaded.faces[cap]][..., 2].min() > 1 - 1e-9
    rest = shaded.faces[~cap]
    round_ = np.einsum("fkd,fkd->fk", shaded.vertex_normals[rest], shaded.vertices[rest]) / 10
    assert round_.min() > 0.99
    assert shaded.volume == pytest.approx(cut.volume, rel=1e-12)
    assert len(shaded.faces) == len(cut.faces)
    assert cut.vertex_normals[cut.faces[cap]][..., 2].min() < 0.95  # what it is for


@pytest.mark.parametrize(
    ("planes", "gap"),
    [
        (Plane((0, 0, 20.0), (0, 0, 1)), 0.01),
        (Plane((0, 0, -20.0), (0, 0, 1)), 0.01),
        ([], 0.01),
        (Plane((0, 0, 0), (0, 0, 1)), 0.0),
    ],
)
def test_cuts_that_miss_or_take_everything(planes, gap):
    with pytest.raises(InputError):
        section(BALL, BALL.scaled(0.9), planes=planes, gap_mm=gap)


def test_planes_need_a_direction_and_wedges_an_angle():
    with pytest.raises(InputError):
        Plane((0, 0, 0), (0, 0, 0))
    with pytest.raises(InputError):
        Plane((0, 0, np.nan), (0, 0, 1))
    with pytest.raises(InputError):
        wedge((0, 0, 0), (0, 0, 1), (1, 0, 0), np.pi)
    with pytest.raises(InputError):
        wedge((0, 0, 0), (0, 0, 1), (0, 0, 2), 1.0)


def test_open_meshes_cannot_be_cut():
    with pytest.raises(InputError, match="closed solid"):
        section(TriangleMesh(BALL.vertices, BALL.faces[1:]), planes=Plane((0, 0, 0), (0, 0, 1)))


def test_thinning_keeps_the_promise_and_the_shape():
    organ = liver(resolution_mm=2.0, cached=False)
    thin, tolerance = thinned(organ, 5000)
    assert 4000 < len(thin.faces) <= 5000
    assert check(thin) == ()
    assert thin.volume == pytest.approx(organ.volume, rel=0.005)
    assert 0 < tolerance < 1.0
    assert thinned(organ, 10**6) == (organ, 0.0)
    with pytest.raises(InputError):
        thinned(organ, 10)


@pytest.mark.parametrize("spacing", [0.0, -1.0, np.nan, 1e-4])
def test_spacings_of_a_field_that_cannot_be(spacing):
    with pytest.raises(InputError, match="spacing_mm"):
        distance_field(BALL, spacing, cached=False)


@pytest.mark.parametrize(
    "mesh", [BALL.flipped(), TriangleMesh(BALL.vertices, BALL.faces[len(BALL.faces) // 2 :])], ids=["flipped", "open"]
)
def test_a_field_needs_a_closed_mesh(mesh):
    with pytest.raises(InputError, match="mesh"):
        distance_field(mesh, 1.0, cached=False)


def test_a_field_is_kept_and_taken_from_the_cache(cache_folder, monkeypatch):
    from livlab.model.shapes import distance

    first = distance_field(BALL, 1.0)
    (kept,) = cache_folder.rglob("*.npz")
    monkeypatch.setattr(distance, "_values", lambda *_: pytest.fail("made again"))
    again = distance_field(BALL, 1.0)
    assert np.array_equal(first.values, again.values)
    assert np.array_equal(first.origin_mm, again.origin_mm)
    monkeypatch.undo()
    monkeypatch.setattr(cache.platformdirs, "user_cache_dir", lambda _: str(cache_folder))
    kept.write_bytes(kept.read_bytes()[:1000])  # a torn file is no answer
    assert np.array_equal(distance_field(BALL, 1.0).values, first.values)
    assert len(list(cache_folder.rglob("*.npz"))) == 1


def test_without_a_place_to_keep_things_they_are_made_anyway(tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("a file where a folder should be")
    monkeypatch.setattr(cache.platformdirs, "user_cache_dir", lambda _: str(blocked))
    mesh = liver(resolution_mm=4.0)
    assert mesh.extent[0] == pytest.approx(140.0)
    monkeypatch.setattr(cache.platformdirs, "user_cache_dir", lambda _: "~nobody/cache")  # no home
    assert np.array_equal(liver(resolution_mm=4.0).vertices, mesh.vertices)


def test_the_cache_forgets_what_was_not_used_for_longest(cache_folder, monkeypatch):
    monkeypatch.setattr(cache, "LIMIT_BYTES", 5000)
    for name in "abc":
        cache.remember("kind", name, {"x": np.zeros(250)})
    assert cache.recall("kind", "a") is None
    assert cache.recall("kind", "c")["x"].shape == (250,)
