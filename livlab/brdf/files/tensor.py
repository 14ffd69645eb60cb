"""Mitsuba's tensor files: named arrays one after the other, the container of its `measured` materials.

Layout, little endian: `tensor_file` and a zero byte, version 1.0 as two bytes, the number of fields (uint32); for each
field the length of its name (uint16), the name, the number of dimensions (uint16), the type (uint8), the offset of its
data from the start of the file (uint64) and its shape (uint64 each); then the data.
"""

import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from livlab.core.files import readable, whole
from livlab.errors import DatasetError

Array = npt.NDArray[np.generic]

MAGIC = b"tensor_file\0"
TYPES: dict[int, str] = {
    1: "u1",
    2: "i1",
    3: "<u2",
    4: "<i2",
    5: "<u4",
    6: "<i4",
    7: "<u8",
    8: "<i8",
    9: "<f2",
    10: "<f4",
    11: "<f8",
}
LARGEST = 1 << 30
"""Bytes; isotropic materials take a few MiB."""

_ALIGN = 8
_MOST_FIELDS = 256


def write_tensors(path: Path, fields: Mapping[str, Array]) -> None:
    """Write named arrays.

    Raises
    ------
    EnvironmentProblem
        The file cannot be written; an old one stays as it was.
    """
    codes = {np.dtype(text): code for code, text in TYPES.items()}
    arrays = {name: np.ascontiguousarray(values) for name, values in fields.items()}
    arrays = {name: values.astype(values.dtype.newbyteorder("<"), copy=False) for name, values in arrays.items()}
    length = len(MAGIC) + 2 + 4 + sum(2 + len(n.encode()) + 2 + 1 + 8 + 8 * a.ndim for n, a in arrays.items())
    head = bytearray(MAGIC + struct.pack("<BBI", 1, 0, len(arrays)))
    offsets, end = [], length
    for name, values in arrays.items():
        end = -(-end // _ALIGN) * _ALIGN
        offsets.append(end)
        label = name.encode()
        head += struct.pack("<H", len(label)) + label
        head += struct.pack(f"<HBQ{values.ndim}Q", values.ndim, codes[values.dtype], end, *values.shape)
        end += values.nbytes
    with whole(path) as temporary, temporary.open("wb") as stream:
        stream.write(head)
        for offset, values in zip(offsets, arrays.values(), strict=True):
            stream.write(b"\0" * (offset - stream.tell()))
            values.tofile(stream)


def read_tensors(path: Path) -> dict[str, Array]:
    """Read all arrays.

    Raises
    ------
    DatasetError
        No such file, another format or version, a type that is not known, data beyond the end of the file.
    """
    try:
        content = readable(path, "BRDF file", LARGEST, "Give an isotropic material.", DatasetError).read_bytes()
    except OSError as error:
        raise DatasetError(f"Cannot read {path}: {error.strerror}.", remedy="Check the path.") from error
    if content[: len(MAGIC)] != MAGIC or content[len(MAGIC) : len(MAGIC) + 2] != b"\1\0":
        raise DatasetError.of(
            path.name, content[:14], "must begin as a tensor file of version 1.0", "Give a .bsdf file of Mitsuba."
        )
    fields: dict[str, Array] = {}
    at = len(MAGIC) + 2
    try:
        (count,) = struct.unpack_from("<I", content, at)
        at += 4
        if count > _MOST_FIELDS:
            raise struct.error(f"{count} fields")
        for _ in range(count):
            (size,) = struct.unpack_from("<H", content, at)
            name = content[at + 2 : at + 2 + size].decode()
            ndim, code, offset = struct.unpack_from("<HBQ", content, at + 2 + size)
            shape = struct.unpack_from(f"<{ndim}Q", content, at + 2 + size + 11)
            at += 2 + size + 11 + 8 * ndim
            dtype = np.dtype(TYPES[code])
            number = 1
            for extent in shape:  # by whole numbers: a damaged shape must not wrap around
                number *= extent
            if offset + number * dtype.itemsize > len(content):
                raise struct.error(f"field {name} ends beyond the file")
            fields[name] = np.frombuffer(content, dtype, number, offset).reshape(shape)
    except (struct.error, KeyError, ValueError, UnicodeDecodeError) as error:
        raise DatasetError(
            f"{path.name} is damaged: {error}.", remedy="Fetch or write it again; it may be cut short."
        ) from error
    return fields
