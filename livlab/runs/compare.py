"""Two runs of one experiment, file by file: the same bytes, the same but for the clock, or by how much they differ."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from livlab.core.netcdf import check_heaps

Verdict = Literal["same", "same but for times", "differs", "only before", "only now", "not compared"]

OF_MACHINE = frozenset({"seconds", "speed", "memory"})
"""Metrics whose claims are about the machine."""

CLOCK = frozenset(
    {"seconds", "seconds_left", "samples_per_second", "trace_seconds", "compile_seconds"}
    | {"setup_seconds", "solving_seconds"}
)
"""Columns and keys that hold what a clock said: no two runs agree on them."""

ACCOUNTS = frozenset({"costs.csv", "ways.csv"})
"""Files about time and speed alone."""

CLAIMS = "claims.csv"

LARGEST_BYTES = 512 << 20


@dataclass(frozen=True)
class FileVerdict:
    """One file of two runs.

    Attributes
    ----------
    name
        Within the run folder.
    verdict
        Whether the bytes are the same; "same but for times" leaves out what a clock said.
    detail
        Where they differ, and by how much.
    """

    name: str
    verdict: Verdict
    detail: str = ""

    @property
    def same(self) -> bool:
        """Whether it holds the same result."""
        return self.verdict in ("same", "same but for times", "not compared")


def timeless(name: str, raw: bytes) -> bytes:
    r"""A file without what a clock said: the columns and keys of `CLOCK` are taken out; others are left alone.

    Of a claim about time, speed or memory the value and its verdict are the machine's: its row is left out.

    >>> timeless("claims.csv", b"criterion,value,seconds\na,1,0.5\n")
    b'criterion,value\na,1\n'
    >>> timeless("claims.csv", b"criterion,value,seconds\na,1,0.5\nseconds of a,0.50004,0.5\n")
    b'criterion,value\na,1\n'
    >>> timeless("claims.csv", b"criterion,value,seconds\na,1,0.5\nspeed a,2e6,0.5\n")
    b'criterion,value\na,1\n'
    """
    if name.endswith(".csv"):
        rows = list(csv.reader(io.StringIO(raw.decode("utf-8", "replace"), newline="")))
        if name == CLAIMS:
            rows = [row for k, row in enumerate(rows) if not k or not _of_time(dict(zip(rows[0], row, strict=False)))]
        dropped = {k for k, column in enumerate(rows[0] if rows else []) if column in CLOCK}
        if not dropped:
            return raw
        out = io.StringIO()
        csv.writer(out, lineterminator="\n").writerows([[c for k, c in enumerate(r) if k not in dropped] for r in rows])
        return out.getvalue().encode()
    if name.endswith(".json"):
        try:
            data = json.loads(raw)
        except ValueError:
            return raw
        return json.dumps(_without_clock(data), sort_keys=True, ensure_ascii=False).encode()
    return _grid_without_clock(raw) if name.endswith(".nc") else raw


def _of_time(claim: Mapping[str, str]) -> bool:
    """Whether a claim judges the machine: by its metric, or since its value is its seconds, which have four digits."""
    if claim.get("criterion", "").partition(" ")[0] in OF_MACHINE:
        return True
    try:
        return float(claim["seconds"]) > 0 and f"{float(claim['value']):.4g}" == f"{float(claim['seconds']):.4g}"
    except (KeyError, ValueError):
        return False


def timeless_hashes(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """Hash of each file without what a clock said, for the manifest; accounts of time are left out."""
    return {
        name: hashlib.sha256(timeless(name, (folder / name).read_bytes())).hexdigest()
        for name in names
        if name not in ACCOUNTS
    }


def compare_file(
    name: str,
    before: Path | None,
    now: Path | bytes | None,
    known: str = "",
    known_timeless: str = "",
    as_then: Callable[[bytes], bytes] | None = None,
) -> FileVerdict:
    """One file of two runs.

    Parameters
    ----------
    name
        Its name.
    before, now
        The two files, of the later one its content will do; None where there is none. `before` may be gone, if the
        manifest still has its hashes.
    known, known_timeless
        The earlier file's hash, as it is and without times, from its manifest.
    as_then
        Gives the later file the names that the earlier one has; None where they are the same.
    """
    had = before is not None or bool(known)
    if not had or now is None:
        return FileVerdict(name, "only now" if now is not None else "only before")
    if name in ACCOUNTS:
        return FileVerdict(name, "not compared", "an account of time")
    raw = now if isinstance(now, bytes) else now.read_bytes()
    raw = raw if as_then is None else as_then(raw)
    old = before.read_bytes() if before is not None else None
    if hashlib.sha256(raw).hexdigest() == (known or hashlib.sha256(old or b"").hexdigest()):
        return FileVerdict(name, "same")
    if old is not None:  # an older livlab may have taken out less
        known_timeless = hashlib.sha256(timeless(name, old)).hexdigest()
    if hashlib.sha256(timeless(name, raw)).hexdigest() == known_timeless:
        return FileVerdict(name, "same but for times")
    if old is None:
        return FileVerdict(name, "differs", "by how much cannot be said: the earlier file is not there")
    return FileVerdict(name, "differs", _how_much(name, old, raw))


def _without_clock(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_clock(v) for k, v in value.items() if k not in CLOCK}
    return [_without_clock(v) for v in value] if isinstance(value, list) else value


def _grid_without_clock(raw: bytes) -> bytes:
    """A NetCDF file whose attributes hold what a clock said, as a digest of all else; any other file as it is."""
    import h5py
    import numpy as np

    told = False
    digest = hashlib.sha256()

    def attributes(path: str, item: Any) -> None:
        nonlocal told
        for key in sorted(item.attrs):
            if key in CLOCK:
                told = True
            elif key not in ("DIMENSION_LIST", "REFERENCE_LIST"):  # places within the file, which its tree tells
                digest.update(f"{path}@{key}={np.asarray(item.attrs[key]).tolist()!r}".encode())

    def visit(path: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            digest.update(f"{path}:{item.dtype.str}{item.shape}".encode())
            values = np.asarray(item[()])
            digest.update(repr(values.tolist()).encode() if values.dtype.hasobject else values.tobytes())
        attributes(path, item)

    try:
        check_heaps(raw)
        with h5py.File(io.BytesIO(raw), "r") as file:
            attributes("/", file)
            file.visititems(visit)
    except (OSError, ValueError, TypeError, KeyError):  # no NetCDF file that can be read: its bytes speak for it
        return raw
    return digest.digest() if told else raw


def _how_much(name: str, old: bytes, new: bytes) -> str:
    if max(len(old), len(new)) > LARGEST_BYTES:
        return f"{len(old)} and {len(new)} bytes"
    try:
        if name.endswith(".csv"):
            return _tables(timeless(name, old), timeless(name, new))
        if name.endswith(".nc"):
            return _grids(old, new)
    except (OSError, ValueError, KeyError) as error:
        return f"cannot be read as what it should be ({error})"
    if len(old) != len(new):
        return f"{len(old)} and {len(new)} bytes"
    return f"{sum(a != b for a, b in zip(old, new, strict=True))} of {len(new)} bytes"


def _tables(old: bytes, new: bytes) -> str:
    a, b = (list(csv.reader(io.StringIO(x.decode("utf-8"), newline=""))) for x in (old, new))
    if not a or not b or a[0] != b[0]:
        return f"columns {', '.join(a[0] if a else [])} and {', '.join(b[0] if b else [])}"
    if len(a) != len(b):
        return f"{len(a) - 1} and {len(b) - 1} rows"
    worst: tuple[float, float, str] = (-1.0, 0.0, "")
    words, cells = 0, 0
    for x, y in zip(a[1:], b[1:], strict=True):
        for column, p, q in zip(a[0], x, y, strict=False):
            if p == q:
                continue
            cells += 1
            u, v = _number(p), _number(q)
            if u is None or v is None:
                words += 1
                continue
            share = abs(u - v) / max(abs(u), abs(v), 1e-300)
            worst = max(worst, (share, abs(u - v), column))
    size = f"; {worst[2]} most, by {worst[1]:.3g} ({100 * worst[0]:.3g} %)" if worst[2] else ""
    told = f"; {words} of them no numbers" if words else ""
    return f"{cells} of {(len(a) - 1) * len(a[0])} cells{size}{told}"


def _grids(old: bytes, new: bytes) -> str:
    import numpy as np
    import xarray as xr

    said = []
    for raw in (old, new):
        check_heaps(raw)
    trees = [xr.open_datatree(io.BytesIO(x), engine="h5netcdf") for x in (old, new)]
    try:
        first, second = ({n.path: n.to_dataset() for n in tree.subtree} for tree in trees)
        for path in first.keys() | second.keys():
            if path not in first or path not in second:
                said.append(f"group {path} in one of them only")
                continue
            a, b = first[path], second[path]
            said += [f"{path}{n} in one of them only" for n in sorted(map(str, set(a.variables) ^ set(b.variables)))]
            told = sorted((a.attrs.keys() | b.attrs.keys()) - CLOCK, key=str)
            changed = [str(k) for k in told if str(a.attrs.get(k)) != str(b.attrs.get(k))]
            said += [f"attributes {', '.join(changed)} of {path}"] if changed else []
            for n in sorted(map(str, set(a.variables) & set(b.variables))):
                x, y = a[n].to_numpy(), b[n].to_numpy()
                if x.shape != y.shape:
                    said.append(f"{n}: shapes {x.shape} and {y.shape}")
                elif x.dtype.kind not in "fiu":
                    said += [f"{n}: other entries"] if not (x == y).all() else []
                elif not np.array_equal(x, y, equal_nan=x.dtype.kind == "f"):
                    gap = np.abs(x.astype(float) - y.astype(float))
                    k = int(np.nanargmax(gap)) if np.isfinite(gap).any() else 0
                    size = f"{n}: up to {gap.flat[k]:.3g} at {float(y.flat[k]):.4g}"
                    error = f"{n}_se"
                    if error in b and b[error].shape == y.shape:
                        se = float(b[error].to_numpy().flat[k])
                        size += f", {gap.flat[k] / se:.2g} standard errors" if se > 0 else ""
                    said.append(size)
    finally:
        for tree in trees:
            tree.close()
    return "; ".join(said[:6]) + (f"; and {len(said) - 6} more" if len(said) > 6 else "") or "the same numbers"


def _number(text: str) -> float | None:
    try:
        found = float(text)
    except ValueError:
        return None
    return found if math.isfinite(found) else None
