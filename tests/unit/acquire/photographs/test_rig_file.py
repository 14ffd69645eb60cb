"""Rig files: what they may say, what is refused with line and key, and that nothing outside is read."""

import pytest

from fuzz.seeds import RIG
from livlab.acquire.photographs.rig_file import read_rig_file, within
from livlab.errors import ConfigError, InputError


def read(tmp_path, text):
    path = tmp_path / "rig.toml"
    path.write_text(text)
    return read_rig_file(path)


def test_a_good_file(tmp_path):
    rig = read(tmp_path, RIG)
    assert rig.light[1].exposures == [1.0, 0.25]
    assert rig.response.kind == "linear"
    assert rig.sphere.radius_mm == 20.0


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("radius_mm = 20.0", "radios_mm = 20.0", r"radios_mm.*radius_mm"),
        ("radius_mm = 20.0", "radius_mm = -1.0", r"radius_mm = -1.0"),
        ("radius_mm = 20.0", 'radius_mm = "20"', r"radius_mm"),
        ("focal_px = 900.0", "", r"focal_px"),
        ('kind = "pinhole"', 'kind = "fisheye"', r"kind"),
        ('kind = "pinhole"', 'kind = "board"', r"board"),
        ("exposures = [1.0, 0.25]", "exposures = [1.0]", r"2 images, 1 exposures"),
        ("exposures = [1.0, 0.25]", "exposures = [1.0, 0.0]", r"exposures"),
        ("direction = [0.0, 0.0, -1.0]", "direction = [0.0, 0.0, 0.0]", r"must not be 0"),
        ("direction = [0.0, 0.0, -1.0]", "direction = [0.0, -1.0]", r"direction"),
        ("direction = [0.0, 0.0, -1.0]", "", r"without a mirror ball"),
        ("direction = [0.0, 0.0, -1.0]", "direction = [nan, 0.0, 1.0]", r"direction"),
        ("position_mm = [10", "direction = [0.0, 0.0, 1.0]\nposition_mm = [10", r"both"),
        ("[sphere]", '[mirror]\nimages=["a"]\n[sphere]', r"mirror"),
        ("[sphere]", '[[mirror]]\nimages=["a"]\n[sphere]', r"1 pictures, 2 lights"),
        ("[sphere]", '[white]\nimage="w.png"\n[sphere]', r"image and box"),
        ("[sphere]", "[white]\nvalue=[0.5]\nlight=2\n[sphere]", r"white.light"),
        ("[sphere]", '[response]\nkind="gamma"\n[sphere]', r"response.gamma"),
        ("[sphere]", '[response]\nkind="debevec"\n[sphere]', r"response.stack"),
        ("format = 1", "format = 2", r"format"),
        ("format = 1", "format = [", r"no TOML"),
        ('images = ["0.png"]', "images = []", r"images"),
    ],
)
def test_wrong_files_are_refused_by_key(tmp_path, old, new, said):
    assert old in RIG
    with pytest.raises(ConfigError, match=said):
        read(tmp_path, RIG.replace(old, new))


def test_an_intensity_of_zero_is_refused(tmp_path):
    for value in ("0.0", "-1.0"):
        with pytest.raises(ConfigError, match="intensity"):
            read(tmp_path, RIG + f"intensity = [{value}]\n")


def test_lines_are_named(tmp_path):
    with pytest.raises(ConfigError, match="line 7"):
        read(tmp_path, RIG.replace("radius_mm = 20.0", "radius_mm = -1.0"))


def test_no_file_and_no_text(tmp_path):
    with pytest.raises(ConfigError, match="is not a file"):
        read_rig_file(tmp_path / "rig.toml")
    (tmp_path / "rig.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="no TOML"):
        read_rig_file(tmp_path / "rig.toml")
    (tmp_path / "rig.toml").write_bytes(b"#" * (2 << 20))
    with pytest.raises(ConfigError, match="1 MiB"):
        read_rig_file(tmp_path / "rig.toml")


@pytest.mark.parametrize("name", ["/etc/passwd", "../a.png", "a/../../b.png", "C:\\a.png", "..\\a.png"])
def test_paths_do_not_lead_out(tmp_path, name):
    with pytest.raises(InputError, match="must be relative"):
        within(tmp_path, name)


def test_links_do_not_lead_out(tmp_path):
    inside, outside = tmp_path / "in", tmp_path / "out"
    inside.mkdir()
    outside.mkdir()
    (outside / "a.png").write_bytes(b"secret")
    (inside / "a.png").symlink_to(outside / "a.png")
    (inside / "sub").symlink_to(outside)
    for name in ("a.png", "sub/a.png"):
        with pytest.raises(InputError, match="through a link"):
            within(inside, name)
    assert within(inside, "sub2/b.png") == (inside / "sub2/b.png").resolve()
