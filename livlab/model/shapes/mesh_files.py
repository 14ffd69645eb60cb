"""Mesh files: PLY, OBJ and STL, counted before they are read, written whole or not at all."""

from __future__ import annotations

import contextlib
import io
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np

from livlab.errors import EnvironmentProblem, InputError
from livlab.model.shapes.checks import MAX_FACES, refuse_too_many
from livlab.model.shapes.mesh import TriangleMesh

UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 1e-3, "inch": 25.4}
"""Millimetres in a unit of length of a file."""

SUFFIXES = (".ply", ".obj", ".stl")

_BLOCK = 1 << 24
_EXPORT_AGAIN = "Export the mesh again as PLY, OBJ or STL."


def read_mesh(path: Path | str, *, unit: str = "mm", max_faces: int = MAX_FACES) -> TriangleMesh:
    """Read a PLY, OBJ or STL file; vertices in one place become one.

    Parameters
    ----------
    path
        File; its first bytes must agree with its suffix.
    unit
        Unit of its coordinates: mm, cm, m, um or inch.
    max_faces
        Files with more are refused by their header, or by counting, before they are read.

    Returns
    -------
    mesh
        In mm, as the file has it: whether it bounds a solid is for `check` to say.

    Raises
    ------
    InputError
        Missing, not of these formats, wrongly named, cut short, empty, or too large.
    """
    if unit not in UNITS_MM:
        raise InputError.of("unit", unit, f"must be one of {', '.join(UNITS_MM)}", "Give the unit of the coordinates.")
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError.of("mesh file", str(path), "must end in .ply, .obj or .stl", _EXPORT_AGAIN)
    if not file.is_file():
        raise InputError.of("mesh file", str(path), "must be a file", "Check the path.")
    size = file.stat().st_size
    with file.open("rb") as stream:
        refuse_too_many(_count_faces(stream, suffix, size, file.name), max_faces)
        stream.seek(0)
        mesh = _load(stream, suffix, file.name)
    if len(mesh.faces) == 0:
        raise InputError.of("mesh file", file.name, "must hold faces", "Export the surface, not points or lines.")
    scale = UNITS_MM[unit]
    return mesh if scale == 1.0 else mesh.scaled(scale)


def write_meshes(files: Mapping[Path, TriangleMesh]) -> None:
    """Write meshes to PLY (binary, double precision), OBJ or STL files: all of them whole, or none.

    Raises
    ------
    InputError
        A name has another suffix.
    EnvironmentProblem
        The disk is full, read-only or forbidden; nothing new is left behind.
    """
    made: list[tuple[Path, Path]] = []
    content = {path: encode(mesh, path.suffix.lower()) for path, mesh in files.items()}
    try:
        for path, raw in content.items():
            temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
            made.append((temporary, path))
            with temporary.open("wb") as stream:
                stream.write(raw)
                stream.flush()
                os.fsync(stream.fileno())
        for temporary, path in made:
            temporary.replace(path)
    except OSError as error:
        place = error.filename or made[-1][1]
        raise EnvironmentProblem(
            f"Cannot write {place}: {error.strerror or error}.", remedy="Free some space, or name another place."
        ) from error
    finally:
        for temporary, _ in made:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)


def encode(mesh: TriangleMesh, suffix: str) -> bytes:
    """Content of a mesh file; PLY and OBJ carry the vertex normals, STL knows only faces and single precision."""
    if suffix == ".ply":
        return _ply(mesh)
    if suffix == ".obj":
        return _obj(mesh)
    if suffix == ".stl":
        faces = np.zeros(
            len(mesh.faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
        )
        faces["normal"], faces["corners"] = mesh.face_normals, mesh.vertices[mesh.faces]
        return b"livlab, mm".ljust(80) + len(faces).to_bytes(4, "little") + faces.tobytes()
    raise InputError.of("mesh file", f"*{suffix}", "must end in .ply, .obj or .stl", "Name it so.")


def _ply(mesh: TriangleMesh) -> bytes:
    names = ("x", "y", "z", "nx", "ny", "nz")
    header = ["ply", "format binary_little_endian 1.0", "comment livlab, mm", f"element vertex {len(mesh.vertices)}"]
    header += [f"property {'double' if len(name) == 1 else 'float'} {name}" for name in names]
    header += [f"element face {len(mesh.faces)}", "property list uchar int vertex_indices", "end_header", ""]
    points = np.zeros(len(mesh.vertices), dtype=[("place", "<f8", 3), ("normal", "<f4", 3)])
    points["place"], points["normal"] = mesh.vertices, mesh.vertex_normals
    faces = np.zeros(len(mesh.faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    return "\n".join(header).encode() + points.tobytes() + faces.tobytes()


def _obj(mesh: TriangleMesh) -> bytes:
    out = io.StringIO()
    out.write("# livlab, mm\n")
    np.savetxt(out, mesh.vertices, fmt="v %.17g %.17g %.17g")
    np.savetxt(out, mesh.vertex_normals, fmt="vn %.7g %.7g %.7g")
    np.savetxt(out, np.repeat(mesh.faces + 1, 2, axis=1), fmt="f %d//%d %d//%d %d//%d")
    return out.getvalue().encode()


def _count_faces(stream: BinaryIO, suffix: str, size: int, name: str) -> int:
    """Faces that the file says it has, from its header or by counting lines; refuses what its suffix belies."""
    head = stream.read(4096)
    if not head:
        raise InputError.of("mesh file", name, "must not be empty", _EXPORT_AGAIN)
    is_ply = head.startswith((b"ply\n", b"ply\r"))
    if is_ply != (suffix == ".ply"):
        found = "is a PLY file by its first bytes" if is_ply else "does not begin as a PLY file"
        raise InputError.of("mesh file", name, found, "Rename it to what it is, or export it again.")
    if suffix == ".ply":
        return _ply_faces(stream, head, name)
    if suffix == ".stl":
        count = int.from_bytes(head[80:84], "little")
        if len(head) >= 84 and size == 84 + 50 * count:
            return count
        if head.lstrip().startswith(b"solid") and b"facet" in head:
            facets, ends = _count(stream, b"endfacet"), _count(stream, b"endsolid")
            if ends == 0:
                raise InputError.of("mesh file", name, f"ends within facet {facets}", "Copy or export the file again.")
            return facets
        found = f"announces {count} faces ({84 + 50 * count} bytes) and has {size} bytes"
        raise InputError.of("mesh file", name, found, "It is cut short, or no STL file: copy or export it again.")
    if b"\0" in head or not any(
        line.split(b" ", 1)[0] in (b"v", b"#", b"o", b"g", b"mtllib") for line in head.splitlines()
    ):
        raise InputError.of("mesh file", name, "does not read as an OBJ file", _EXPORT_AGAIN)
    return _count(stream, b"\nf ")


def _ply_faces(stream: BinaryIO, head: bytes, name: str) -> int:
    end = head.find(b"end_header")
    while end < 0 and len(head) < 1 << 20:
        more = stream.read(4096)
        if not more:
            break
        head += more
        end = head.find(b"end_header")
    words = [line.split() for line in head[: max(end, 0)].decode("latin-1").splitlines()]
    counts = {word[1]: word[2] for word in words if len(word) == 3 and word[0] == "element"}
    if end < 0 or not all(re.fullmatch("[0-9]{1,12}", counts.get(name, "")) for name in ("vertex", "face")):
        raise InputError.of("mesh file", name, "has no PLY header with vertices and faces", _EXPORT_AGAIN)
    if int(counts["vertex"]) > 3 * max(int(counts["face"]), MAX_FACES):
        raise InputError.of("vertices", int(counts["vertex"]), "are more than the faces can use", _EXPORT_AGAIN)
    return int(counts["face"])


def _count(stream: BinaryIO, word: bytes) -> int:
    stream.seek(0)
    total, tail = 0, b"\n"
    while block := stream.read(_BLOCK):
        joined = tail + block
        total += joined.count(word)
        tail = joined[-len(word) + 1 :]
    return total


def _load(stream: BinaryIO, suffix: str, name: str) -> TriangleMesh:
    import trimesh

    try:
        loaded = trimesh.load_mesh(stream, file_type=suffix[1:], process=False, skip_materials=True)
        points = np.asarray(loaded.vertices, dtype=np.float64) + 0.0
        faces = np.asarray(loaded.faces, dtype=np.int64).reshape(-1, 3)
    except Exception as error:  # readers of broken files raise whatever they stumble over
        reason = f"cannot be read ({type(error).__name__}: {error})"[:200]
        raise InputError.of(
            "mesh file", name, reason, "It is damaged or cut short: copy or export it again."
        ) from error
    if len(points) == 0 or len(faces) == 0:
        return TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32))
    return merged(TriangleMesh(points, faces))


def merged(mesh: TriangleMesh) -> TriangleMesh:
    """One vertex where several have the same coordinates to the last bit; unused ones go."""
    used = np.flatnonzero(np.bincount(mesh.faces.reshape(-1), minlength=len(mesh.vertices)))
    order = np.lexsort(mesh.vertices[used].T)
    points = mesh.vertices[used][order]
    new = np.ones(len(points), dtype=bool)
    new[1:] = (points[1:] != points[:-1]).any(axis=1)
    number = np.empty(len(mesh.vertices), dtype=np.int64)
    first = used[order][new]  # the lowest of each group keeps its turn
    group = np.cumsum(new) - 1
    lowest = np.full(len(first), len(mesh.vertices), dtype=np.int64)
    np.minimum.at(lowest, group, used[order])
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(lowest)] = np.arange(len(first))
    number[used[order]] = rank[group]
    return TriangleMesh(mesh.vertices[np.sort(lowest)], number[mesh.faces])
