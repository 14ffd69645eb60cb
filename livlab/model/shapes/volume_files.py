"""Segmentations from files: NIfTI, NRRD, NumPy, and folders of images."""

from __future__ import annotations

import bz2
import io
import re
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from livlab.core.files import DENSEST, readable
from livlab.core.picture_files import DENSEST_TIFF, check_claim, check_png, check_png_pixels, opened_tiff
from livlab.errors import InputError
from livlab.model.shapes.volume import Segmentation

MAX_VOXELS = 1_000_000_000
MAX_BYTES = 16 * MAX_VOXELS
"""What a file of so many voxels takes, at 128 bits each."""

_ORDERS: tuple[Literal["little", "big"], ...] = ("little", "big")

_IMAGES = (".png", ".tif", ".tiff")
_LPS_FROM_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])
_DAMAGED = "It is damaged or cut short, or not what its name says: copy or export it again."


def is_volume(path: Path) -> bool:
    """Whether the name is one that `read_volume` takes."""
    return path.is_dir() or path.name.lower().endswith((".nii", ".nii.gz", ".nrrd", ".nhdr", ".npy", ".npz"))


def read_volume(
    path: Path | str,
    *,
    spacing_mm: Sequence[float] | None = None,
    label: int | None = None,
    threshold: float | None = None,
) -> Segmentation:
    """Read a segmentation.

    Parameters
    ----------
    path
        NIfTI (.nii, .nii.gz), NRRD (.nrrd, .nhdr), NumPy (.npy, .npz), or a folder of PNG or TIFF images, one a slice,
        in the order of the numbers in their names. Arrays and images are [z, y, x].
    spacing_mm
        Voxel edges along x, y and z; needed where the file has none. In .npz files the array `spacing_mm` holds it.
    label
        Value of the voxels that are inside; every value but 0 unless said.
    threshold
        For grey values: what is above it is inside. Exclusive with `label`.

    Returns
    -------
    segmentation
        NIfTI's and NRRD's axes are turned to x left, y back, z head.

    Raises
    ------
    InputError
        Missing, of another format, damaged, too large, grey without a threshold, without a spacing or with one that is
        not positive, images of different sizes, or nothing inside.
    """
    file = Path(path)
    if not file.exists():
        raise InputError.of("volume", str(path), "must exist", "Check the path.")
    if label is not None and threshold is not None:
        raise InputError.of("label", label, "excludes a threshold", "Give one of the two.")
    name = file.name.lower()
    notes: list[str] = []
    if file.is_dir():
        values, affine = _images(file), None
    elif name.endswith((".nii", ".nii.gz")):
        values, affine, notes = _nifti(file)
    elif name.endswith((".nrrd", ".nhdr")):
        values, affine, notes = _nrrd(file)
    elif name.endswith((".npy", ".npz")):
        values, affine = _numpy(file)
    else:
        known = ".nii, .nii.gz, .nrrd, .npy, .npz or a folder of images"
        raise InputError.of("volume", str(path), f"must be {known}", "Convert it, with 3D Slicer say.")
    if spacing_mm is not None:
        plain = affine is None or name.endswith(".npz")
        affine = _affine_of(spacing_mm, values.ndim) if plain or affine is None else _respaced(affine, spacing_mm)
    if affine is None:
        raise InputError.of("voxel spacing", None, "is not in the file", "Give --spacing: x, y and z in mm.")
    return Segmentation(_inside(values, label, threshold), affine, tuple(notes))


def _inside(values: NDArray[Any], label: int | None, threshold: float | None) -> NDArray[np.bool_]:
    if values.dtype.kind not in "buif":
        raise InputError.of("volume", str(values.dtype), "must hold numbers", "Export one value a voxel.")
    if threshold is not None:
        return np.asarray(values > threshold)
    if values.dtype.kind == "f" and not np.array_equal(values, np.rint(values)):
        if not np.isfinite(values).all():
            raise InputError.of("volume", "NaN or infinity", "must be finite", "Fill those voxels.")
        bound = "holds grey values, not labels"
        raise InputError.of("volume", f"{values.min():.4g}..{values.max():.4g}", bound, "Give --threshold.")
    if label is None:
        return np.asarray(values != 0)
    inside = np.asarray(values == label)
    if not inside.any():
        there = np.unique(values)
        shown = ", ".join(f"{v:g}" for v in there[:12]) + (" ..." if len(there) > 12 else "")
        raise InputError.of("label", label, f"is on no voxel; the volume holds {shown}", "Choose one of these.")
    return inside


def _affine_of(spacing_mm: Sequence[float], axes: int) -> NDArray[np.float64]:
    """Affine of an array [z, y, x] whose first voxel lies at the origin."""
    spacing = np.asarray(spacing_mm, dtype=np.float64).reshape(-1)
    spacing = np.repeat(spacing, 3) if spacing.size == 1 else spacing
    if spacing.shape != (3,) or not (np.isfinite(spacing).all() and (spacing > 0).all()):
        raise InputError.of(
            "voxel spacing", np.asarray(spacing_mm).tolist(), "must be three lengths > 0", "x, y, z in mm."
        )
    if axes != 3:
        raise InputError.of("volume", f"{axes} axes", "must have three", "Pick one time point or channel.")
    affine = np.zeros((4, 4))
    affine[3, 3] = 1.0
    affine[[0, 1, 2], [2, 1, 0]] = spacing
    return affine


def _respaced(affine: NDArray[np.float64], spacing_mm: Sequence[float]) -> NDArray[np.float64]:
    """Keep directions and origin, replace the lengths."""
    wanted = np.linalg.norm(_affine_of(spacing_mm, 3)[:3, :3], axis=1)
    length = np.linalg.norm(affine[:3, :3], axis=0)
    if not (np.isfinite(length).all() and (length > 0).all()):
        remedy = "The file's axes are flat: export it again."
        raise InputError.of("voxel spacing", length.tolist(), "must be > 0", remedy)
    changed = affine.copy()
    changed[:3, :3] = affine[:3, :3] / length * wanted
    return changed


def _nifti(file: Path) -> tuple[NDArray[Any], NDArray[np.float64], list[str]]:
    import nibabel

    notes = []
    try:
        # By its class, not by nibabel.load: that would follow an extension in the header to formats of many files.
        image: Any = _nifti_class(file).from_filename(file)
        shape = tuple(int(n) for n in image.shape)
        _refuse_large(shape)
        _refuse_empty_claim(file, shape, image.get_data_dtype().itemsize)
        unit = image.header.get_xyzt_units()[0] if hasattr(image.header, "get_xyzt_units") else "unknown"
        with nibabel.openers.ImageOpener(str(file)) as stream:  # a loaded header has been mended in silence
            written = type(image.header).from_fileobj(stream, check=False)
        zooms = np.asarray(written["pixdim"][1:4] if "pixdim" in written else written.get_zooms()[:3], dtype=np.float64)
        affine = np.asarray(image.affine, dtype=np.float64)
        values = np.asanyarray(image.dataobj)
    except InputError:
        raise
    except Exception as error:  # nibabel raises its own, zlib's, OS's and value errors
        raise _damaged(file, error) from error
    if not (np.isfinite(zooms).all() and (zooms > 0).all()):
        raise InputError.of(
            "voxel spacing", zooms.tolist(), "must be > 0", "Mend the header's pixdim, or export it again."
        )
    scale = {"mm": 1.0, "meter": 1000.0, "micron": 1e-3}.get(unit)
    if scale is None:
        notes.append("The file names no unit of length: taken as mm.")
        scale = 1.0
    values = values.reshape(shape[:3]) if len(shape) > 3 and np.prod(shape[3:]) == 1 else values
    return values, _LPS_FROM_RAS @ np.diag([scale, scale, scale, 1.0]) @ affine, notes


def _nifti_class(file: Path) -> Any:
    """The class that reads a NIfTI file but for the extensions of its header: nothing here needs them.

    nibabel sets aside what each says of its length (up to 2 GiB), and only then looks for the bytes.
    """
    import nibabel

    with nibabel.openers.ImageOpener(str(file)) as stream:
        length = stream.read(4)
    second = 540 in (int.from_bytes(length, order) for order in _ORDERS)
    plain: Any = nibabel.Nifti2Image if second else nibabel.Nifti1Image

    class NoExtensions(plain.header_class.exts_klass):  # type: ignore[misc]
        @classmethod
        def from_fileobj(cls, *_: object) -> Any:
            return cls()

    header = type("Header", (plain.header_class,), {"exts_klass": NoExtensions})
    return type("Image", (plain,), {"header_class": header})


def _nrrd(file: Path) -> tuple[NDArray[Any], NDArray[np.float64], list[str]]:
    import nrrd  # type: ignore[import-untyped]

    notes = []
    try:
        with file.open("rb") as stream:
            header = nrrd.read_header(stream)
            _refuse_large(tuple(int(n) for n in header["sizes"]))
            values = nrrd.read_data(header, io.BytesIO(_nrrd_content(file, header, stream)))
    except InputError:
        raise
    except Exception as error:
        raise _damaged(file, error) from error
    affine = np.eye(4)
    if header.get("space directions") is not None:
        directions = np.asarray(header["space directions"], dtype=np.float64)
        if directions.shape != (3, 3) or not np.isfinite(directions).all():
            raise InputError.of(
                "volume", directions.shape, "must have three axes in space", "Pick one channel or time."
            )
        affine[:3, :3] = directions.T
        affine[:3, 3] = np.asarray(header.get("space origin", np.zeros(3)), dtype=np.float64)
    elif header.get("spacings") is not None:
        affine[:3, :3] = np.diag(np.asarray(header["spacings"], dtype=np.float64)[:3])
    else:
        raise InputError.of(
            "voxel spacing", None, "is not in the file", "Write `spacings` or `space directions` into it."
        )
    space = str(header.get("space", "")).lower()
    if space in ("right-anterior-superior", "ras"):
        affine = _LPS_FROM_RAS @ affine
    elif space in ("left-anterior-superior", "las"):
        affine = np.diag([1.0, -1.0, 1.0, 1.0]) @ affine
    elif space not in ("left-posterior-superior", "lps"):
        notes.append("The file does not say which way its axes look: taken as left, back, head.")
    units = [str(u).lower() for u in header.get("space units", [])]
    scale = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 1e-3, "microns": 1e-3}.get(units[0] if units else "mm", 1.0)
    return values, np.diag([scale, scale, scale, 1.0]) @ affine, notes


def _nrrd_content(file: Path, header: Any, stream: BinaryIO) -> bytes:
    """The data of an NRRD file, decompressed to no more than its header says; `header` then describes these bytes.

    pynrrd would follow a name to any file, skip lines without end, and decompress whatever there is.
    """
    import nrrd

    named = header.pop("datafile", None) or header.pop("data file", None)
    if named is not None:
        beside = (file.parent / str(named)).resolve()
        if beside.parent != file.parent.resolve():
            raise InputError.of("volume, data file", str(named), "must lie beside the header", "Move it there.")
        with readable(beside, "volume, data file", MAX_BYTES, _DAMAGED).open("rb") as data:
            content = data.read()
    else:
        content = stream.read()
    lines, skip = (
        int(header.pop(a, header.pop(b, 0))) for a, b in (("lineskip", "line skip"), ("byteskip", "byte skip"))
    )
    for _ in range(min(lines, len(content))):
        content = content[content.find(b"\n") + 1 :] if b"\n" in content else b""
    itemsize = nrrd.reader._determine_datatype(header).itemsize
    needed = int(np.prod([int(n) for n in header["sizes"]], dtype=object)) * itemsize
    encoding = str(header["encoding"]).lower()
    if encoding in ("gzip", "gz", "bzip2", "bz2"):
        unpack: Any = zlib.decompressobj(zlib.MAX_WBITS | 16) if encoding.startswith("g") else bz2.BZ2Decompressor()
        content = unpack.decompress(content, needed + max(skip, 0) + 1)
        if len(content) > needed + max(skip, 0):
            raise ValueError(f"unpacks to more than the {needed} bytes that its header says")
        header["encoding"] = "raw"
    if skip < -1:
        raise ValueError(f"byte skip {skip}")
    return content[-needed:] if skip == -1 else content[skip:]


def _numpy(file: Path) -> tuple[NDArray[Any], NDArray[np.float64] | None]:
    try:
        if file.suffix.lower() == ".npy":
            mapped = np.load(file, mmap_mode="r", allow_pickle=False)
            _refuse_large(mapped.shape)
            return np.asarray(mapped), None
        with np.load(readable(file, "volume", MAX_BYTES, _DAMAGED), allow_pickle=False) as held:
            _refuse_bomb(file)
            spacing = held["spacing_mm"] if "spacing_mm" in held.files else None
            names = [name for name in held.files if name != "spacing_mm"]
            if len(names) != 1:
                raise InputError.of(
                    "volume", names, "must be one array beside spacing_mm", "Save only the segmentation."
                )
            values = held[names[0]]
    except InputError:
        raise
    except Exception as error:
        raise _damaged(file, error) from error
    _refuse_large(values.shape)
    return values, None if spacing is None else _affine_of(spacing.reshape(-1).tolist(), values.ndim)


def _images(folder: Path) -> NDArray[Any]:
    files = [f for f in folder.iterdir() if f.suffix.lower() in _IMAGES and not f.name.startswith(".")]
    files.sort(key=lambda f: [int(word) if word.isdecimal() else word.lower() for word in re.split(r"(\d+)", f.name)])
    if len(files) < 2:
        raise InputError.of(
            "volume", str(folder), f"holds {len(files)} PNG or TIFF images, must hold two or more", "One a slice."
        )
    slices: list[NDArray[Any]] = []
    for file in files:
        one = _image(file)
        if one.ndim == 3 and one.shape[2] in (3, 4):
            if not (one[..., :1] == one[..., :3]).all():
                raise InputError.of("volume", file.name, "is a colour image", "Export the labels as grey values.")
            one = one[..., 0]
        if one.ndim != 2:
            raise InputError.of("volume", f"{file.name} {one.shape}", "must be one grey image", "One file a slice.")
        if slices and one.shape != slices[0].shape:
            found = (
                f"has {one.shape[1]}×{one.shape[0]} pixels, {files[0].name} {slices[0].shape[1]}×{slices[0].shape[0]}"
            )
            raise InputError.of("volume", file.name, found, "Keep only slices of one size in the folder.")
        slices.append(one)
        _refuse_large((len(files), *one.shape))
    return np.stack(slices)


def _image(file: Path) -> NDArray[Any]:
    try:
        if file.suffix.lower() == ".png":
            from PIL import Image

            check_png(file, "volume")
            with Image.open(file, formats=("PNG",)) as opened:
                _refuse_large(opened.size)
                check_png_pixels(file, "volume")
                return np.asarray(opened)
        with opened_tiff(file, "volume") as stack:
            _refuse_large(stack.series[0].shape)
            check_claim(file, "volume", stack.series[0].nbytes, DENSEST_TIFF)
            return np.asarray(stack.asarray())
    except InputError:
        raise
    except Exception as error:
        raise _damaged(file, error) from error


def _refuse_bomb(file: Path) -> None:
    """Refuse an .npz whose arrays are larger than a volume may be, before one is unpacked."""
    import zipfile

    with zipfile.ZipFile(file) as held:
        unpacked = sum(member.file_size for member in held.infolist())
    if unpacked > MAX_BYTES:
        bound = f"must unpack to at most {MAX_BYTES >> 30} GiB"
        raise InputError.of("volume", f"{unpacked / 2**30:.1f} GiB", bound, "Save only the segmentation, cropped.")


def _refuse_empty_claim(file: Path, shape: Sequence[int], itemsize: int) -> None:
    """Refuse a header that claims more than its file can hold, however well it is compressed."""
    claimed, size = int(np.prod([int(n) for n in shape], dtype=object)) * itemsize, file.stat().st_size
    if claimed > (DENSEST if file.suffix == ".gz" else 1) * size:
        bound = f"cannot be read: its header claims {claimed} bytes of voxels, and it has {size}"
        raise InputError.of("volume", file.name, bound, _DAMAGED)


def _refuse_large(shape: Sequence[int]) -> None:
    voxels = int(np.prod([int(n) for n in shape], dtype=object))
    if voxels > MAX_VOXELS:
        bound = f"must be at most {MAX_VOXELS} voxels"
        raise InputError.of("volume", f"{'×'.join(map(str, shape))}", bound, "Crop it, or take every second voxel.")
    if voxels == 0:
        raise InputError.of("volume", tuple(shape), "must not be empty", "Export it again.")


def _damaged(file: Path, error: Exception) -> InputError:
    return InputError.of("volume", file.name, f"cannot be read ({type(error).__name__}: {error})"[:200], _DAMAGED)
