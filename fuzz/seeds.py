"""Valid files to start from, made by livlab's own writers (and by the library's where livlab does not write).

Tests of readers take small files from here, too, so that what is fuzzed is what is tested.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

SPECTRAL = """\
schema = 1
kind = "spectral"
name = "seed"
title = "Seed"
readings = ["thesis", "measured"]
tissue = { variant = "parenchyma_only" }
wavelengths = { list_nm = [500, 600, 700] }
instrument = { kind = "hyperspectral-camera" }
solver = { kind = "adding-doubling", tolerance = 1e-2 }
"""
RIG = """\
format = 1
name = "a ball"
[camera]
kind = "pinhole"
focal_px = 900.0
[sphere]
radius_mm = 20.0
[[light]]
images = ["0.png"]
direction = [0.0, 0.0, -1.0]
[[light]]
images = ["1.png", "1s.png"]
exposures = [1.0, 0.25]
position_mm = [10.0, 20.0, -300.0]
"""
SPECTRUM = "wavelength_nm;reflectance [%]\n" + "".join(f"{x};{10 + x / 100:.2f}\n" for x in range(450, 701, 50))
PROFILE = "depth_from,depth_to,elastin,collagen\n0,0.5,0.1,0.2\n0.5,1,0.05,0.3\n"
META = """\
format = 1
name = "{name}"
version = "{version}"
title = "A liver of mine"
source = "measured here"
kind = "tabulated"
range_nm = [450.0, {longest_nm}]
licence = "mine"
read_in = "a test"
sha256 = "{sha256}"
[uncertainty]
text = "unknown"
[columns.wavelength_nm]
unit = "nm"
description = "wavelength"
[columns.reflectance]
unit = "1"
description = "reflectance"
"""


def seeds(name: str, place: Path) -> list[bytes]:
    """Inputs to start from for a target; for one that reads a folder, `place/folder` is left as a whole one."""
    place.mkdir(parents=True, exist_ok=True)
    folder = place / "folder"
    if name.startswith("run") or name == "gallery":
        made = _run_folder(name, place)
        if not folder.exists():
            made.rename(folder)
        return _of_folder(name, folder)
    kind, _, form = name.partition("-")
    if kind == "mesh":
        from livlab.model.shapes import box
        from livlab.model.shapes.mesh_files import encode

        ball = box((1.0, 2.0, 3.0))
        found = [encode(ball, f".{form}")]
        if form == "ply":
            found.append(ball.as_trimesh().export(file_type="ply", encoding="ascii"))
        if form == "stl":
            found.append(ball.as_trimesh().export(file_type="stl_ascii").encode())
        if form == "obj":
            found.append(b"mtllib x.mtl\no a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1 -1\nl 1 2\n")
        return found
    if kind == "volume":
        return _volume(form, folder)
    if kind == "brdf":
        from fuzz.brdf_seeds import SEEDS

        return SEEDS[form](place)
    if kind in ("photograph", "micrograph"):
        return _picture(form)
    if name == "photographs":
        return _photographs(folder)
    if name == "ledger":
        return [_ledger(place / "seed.nc")]
    if name == "experiment":
        from livlab.config import builtin_experiments

        return [SPECTRAL.encode(), *(p.read_bytes() for p in builtin_experiments().values())]
    if name == "preset":
        from importlib import resources

        presets = resources.files("livlab.model.tissue") / "preset_files"
        return [(presets / f"{organ}.toml").read_bytes() for organ in ("liver", "skin")]
    if name == "dataset":
        folder = place / "folder"
        folder.mkdir(exist_ok=True)
        table = SPECTRUM.replace(";", ",").replace("reflectance [%]", "reflectance").encode()
        meta = user_meta(table, name="attempt", longest_nm=700.0).encode()
        (folder / "meta.toml").write_bytes(meta)
        (folder / "table.csv").write_bytes(table)
        return [b"\0" + meta, b"\1" + table]
    if name == "bench":
        return [json.dumps(_bench(), separators=(",", ":")).encode()] if _empty(folder) else []
    texts = {
        "rig": RIG,
        "spectrum": SPECTRUM,
        "profile-csv": PROFILE,
        "profile-toml": "[[sublayers]]\ndepth_from = 0.0\ndepth_to = 1.0\nelastin = 0.1\ncollagen = 0.2\n",
        "claims": "criterion,value,standard_error,reference,tolerance,verdict,seconds\na,1.0,0.1,1.0,0.5,PASS,2.0\n",
    }
    return [texts[name].encode()]


def user_meta(table: bytes, *, name: str = "my_liver", version: str = "1", longest_nm: float = 750.0) -> str:
    """The meta.toml of a user's spectrum from 450 nm on."""
    sha256 = hashlib.sha256(table).hexdigest()
    return META.format(name=name, version=version, longest_nm=longest_nm, sha256=sha256)


def _empty(folder: Path) -> bool:
    folder.mkdir(exist_ok=True)
    return True


def _of_folder(name: str, folder: Path) -> list[bytes]:
    from fuzz.targets import TARGETS, names_in

    names = names_in(TARGETS[name], folder)
    prefix = [bytes([k]) if len(names) > 1 else b"" for k in range(len(names))]
    return [p + (folder / n).read_bytes() for p, n in zip(prefix, names, strict=True) if (folder / n).exists()]


def _run_folder(name: str, place: Path) -> Path:
    from livlab.config import parse_experiment
    from livlab.kinds import execute as runs

    if (place / "folder").exists():
        return place / "folder"
    if name in ("gallery", "run-picture"):
        sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "helpers"))
        import functools
        from unittest import mock

        from picture_fakes import BallCamera, small

        from livlab.kinds.picture import job as picture

        made = functools.partial(picture.prepare, make_camera=BallCamera)
        with mock.patch.object(picture, "prepare", made):
            done = runs.execute(small(), base=place / "runs", report=False).folder
        if name == "run-picture":
            return done
        (place / "held").mkdir()
        done.rename(place / "held" / "run")
        return place / "held"
    text = SPECTRAL
    if name == "run-optics":
        from livlab.config import builtin_experiments

        text = builtin_experiments()["optics-mie-rayleigh"].read_text(encoding="utf-8")
    return runs.execute(parse_experiment(text), base=place / "runs", report=False).folder


def _volume(form: str, folder: Path) -> list[bytes]:
    values = np.zeros((5, 4, 3), dtype=np.uint8)
    values[1:4, 1:3, 1] = 1
    out = io.BytesIO()
    if form.startswith("nifti"):
        import nibabel

        image: Any = nibabel.Nifti1Image(values, np.eye(4))
        image.header.set_xyzt_units("mm")
        second: Any = nibabel.Nifti2Image(values, np.diag([0.5, 0.5, 2.0, 1.0]))
        found = [image.to_bytes(), second.to_bytes()]
        return [gzip.compress(x, mtime=0) for x in found] if form.endswith("gz") else found
    if form == "nrrd":
        head = "NRRD0004\ntype: uint8\ndimension: 3\nspace: left-posterior-superior\nsizes: 5 4 3\nspace directions: "
        head += "(1,0,0) (0,1,0) (0,0,1)\nkinds: domain domain domain\nendian: little\nencoding: {}\nspace origin: "
        head += "(0,0,0)\n\n"
        raw = values.tobytes(order="F")
        detached = (
            "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 5 4 3\nspacings: 1 1 1\nencoding: raw\ndata file: x.raw\n\n"
        )
        text = " ".join(map(str, raw)).encode()
        return [
            head.format("raw").encode() + raw,
            head.format("gzip").encode() + gzip.compress(raw, mtime=0),
            head.format("ascii").encode() + text,
            detached.encode(),
        ]
    if form == "npy":
        np.save(out, values)
    elif form == "npz":
        np.savez_compressed(out, values=values, spacing_mm=np.ones(3))
    else:
        import tifffile
        from PIL import Image

        folder.mkdir(exist_ok=True)
        Image.fromarray(values[:, :, 1]).save(folder / "0.png")
        tifffile.imwrite(folder / "1.tif", values[:, :, 1])
        return [b"\0" + (folder / "0.png").read_bytes(), b"\1" + (folder / "1.tif").read_bytes()]
    return [out.getvalue()]


def _picture(form: str) -> list[bytes]:
    from PIL import Image

    rgb = np.arange(8 * 6 * 3, dtype=np.uint8).reshape(8, 6, 3)
    if form == "png":
        import cv2

        deep = cv2.imencode(".png", rgb.astype(np.uint16) * 300)[1].tobytes()
        return [_saved(Image.fromarray(rgb), "png"), _saved(Image.fromarray(rgb[..., 0]), "png"), deep]
    if form == "tiff":
        import tifffile

        found = []
        for array, more in ((rgb, {"photometric": "rgb"}), (rgb.astype(np.uint16), {"photometric": "rgb"})):
            out = io.BytesIO()
            tifffile.imwrite(out, array, **more)  # type: ignore[arg-type]
            found.append(out.getvalue())
        out = io.BytesIO()
        tifffile.imwrite(out, rgb.transpose(2, 0, 1), metadata={"axes": "CYX"}, compression="zlib", imagej=False)
        return [*found, out.getvalue()]
    if form == "exr":
        import tempfile

        import xarray as xr

        from livlab.model.colour import write_exr

        with tempfile.TemporaryDirectory() as folder:
            image = xr.DataArray(rgb / 255, dims=("row", "column", "channel"), coords={"channel": list("RGB")})
            return [write_exr(Path(folder) / "x.exr", image).read_bytes()]
    if form == "dng":
        return [dng()]
    return [_saved(Image.fromarray(rgb), kind) for kind in ("jpeg", "tga", "bmp", "webp", "gif", "ppm")]


def _saved(image: Any, kind: str) -> bytes:
    out = io.BytesIO()
    image.save(out, format=kind)
    return out.getvalue()


def dng(cfa: Any = None, black: int = 512, white: int = 16383, exposure: tuple[int, int] = (1, 50)) -> bytes:
    """A camera's raw file as small as can be: a Bayer mosaic (a ramp if none is given) in a DNG."""
    import tifffile

    identity = (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1)
    tags = [
        (33421, 3, 2, (2, 2), True),
        (33422, 1, 4, b"\x00\x01\x01\x02", True),
        (33434, 5, 1, exposure, True),
        (50706, 1, 4, b"\x01\x04\x00\x00", True),
        (50707, 1, 4, b"\x01\x01\x00\x00", True),
        (50708, 2, 0, "a camera", True),
        (50714, 3, 1, black, True),
        (50717, 3, 1, white, True),
        (50721, 10, 9, identity, True),
        (50728, 5, 3, (1, 1, 1, 1, 1, 1), True),
        (50778, 3, 1, 21, True),
    ]
    ramp = np.linspace(black, white, 64 * 64).astype(np.uint16).reshape(64, 64)
    out = io.BytesIO()
    tifffile.imwrite(out, ramp if cfa is None else cfa, photometric="CFA", extratags=tags, metadata=None)  # type: ignore[arg-type]
    return out.getvalue()


def _photographs(folder: Path) -> list[bytes]:
    from PIL import Image

    folder.mkdir(exist_ok=True)
    row, column = np.mgrid[:32, :32]
    ball = (np.hypot(row - 15.5, column - 15.5) < 12).astype(np.uint8)
    for k in range(2):
        Image.fromarray(np.repeat((ball * (120 + 40 * k))[..., None], 3, axis=2)).save(folder / f"{k}.png")
    Image.fromarray(ball * 255).save(folder / "mask.png")
    texts = {
        "filenames.txt": "0.png\n1.png\n",
        "light_directions.txt": "0 0 1\n0.6 0 0.8\n",
        "light_intensities.txt": "1 1 1\n1 0.9 0.8\n",
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return [bytes([k]) + t.encode() for k, t in enumerate(texts.values())] + [
        b"\3" + (folder / "mask.png").read_bytes()
    ]


def _ledger(path: Path) -> bytes:
    from livlab.model.tissue.phase.functions import HenyeyGreenstein
    from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer
    from livlab.model.transport.ledger.record_ledger import record

    w, one = np.array([500.0, 600.0]), np.ones(2)
    part = Interaction("cells", 9.0 * one, 0.9 * one, (HenyeyGreenstein(0.5),) * 2)
    stack = OpticalStack(w, (PlaneLayer("slab", 0.1, 1.36 * one, (part,)),), one, one, "slab")
    record(stack, samples=20, seed=1).save(path)
    return path.read_bytes()


def _bench() -> dict[str, Any]:
    from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
    from livlab.kinds.spectral.bench import bench_data
    from livlab.model.tissue.presets import load_preset
    from livlab.model.tissue.readings import READINGS

    tissue = load_preset("liver", changes={"layers.parenchyma.thickness_mm": float("inf")})
    grid = np.array([500.0, 600.0, 700.0])
    camera = HyperspectralCamera(polarisation="crossed", acceptance_deg=60.0)
    return bench_data(tissue, READINGS["measured"], grid, camera, references=[], standard_error=2e-2)


def main() -> None:
    """Write the seeds of a target: `python -m fuzz.seeds TARGET PLACE`."""
    name, place = sys.argv[1], Path(sys.argv[2])
    for k, content in enumerate(seeds(name, place / "seed")):
        (place / "corpus" / f"seed-{k}").write_bytes(content)


if __name__ == "__main__":
    main()
