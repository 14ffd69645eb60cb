"""Every reader of a user's file, held against damage by structure: cut, overwritten, spliced, blown up, not text.

Some dozen inputs a reader in `make test`, 300 under `-m slow`; `make fuzz` searches by coverage (docs/robustness.md).
"""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from fuzz.seeds import seeds
from fuzz.targets import TARGETS, attempt, bounded

CHEAP = sorted(name for name, target in TARGETS.items() if target.cost == 1)
DEAR = sorted(name for name, target in TARGETS.items() if target.cost > 1)
PIECES = (
    b"nan", b"-inf", b"1e999", b"9" * 5000, b"0x" + b"f" * 5000, b"-1", b"\0", b"\xef\xbb\xbf", b"\r\n", b"\xff\xfe",
    "٣٫٥".encode(), b"1,5", b"../../x", b"[" * 300, b"a." * 300, b"<script>alert(1)</script>", b"\xff" * 8,
    b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f", b"1000000000000", b"%s%n", "\u202e\ud7ff".encode(), b'"', b"'''", b"\n",
)  # fmt: skip


@st.composite
def damaged(draw: st.DrawFn, start: list[bytes]) -> bytes:
    """A valid file with up to four things done to it."""
    content = draw(st.sampled_from(start))
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(content)))
        end = draw(st.integers(at, min(len(content), at + 64)))
        how = draw(st.sampled_from(["cut", "drop", "piece", "bytes", "again", "flip"]))
        if how == "cut":
            content = content[:at]
        elif how == "drop":
            content = content[:at] + content[end:]
        elif how == "piece":
            content = content[:at] + draw(st.sampled_from(PIECES)) + content[end:]
        elif how == "bytes":
            content = content[:at] + draw(st.binary(max_size=16)) + content[end:]
        elif how == "again":
            content = content[:at] + content[at:end] * draw(st.integers(2, 50)) + content[end:]
        elif at < len(content):
            content = content[:at] + bytes([content[at] ^ (1 << draw(st.integers(0, 7)))]) + content[at + 1 :]
    return content


def hold(name: str, place: Path, inputs: int) -> None:
    """Hand so many damaged files to a reader; whatever is no error of livlab's own comes out here."""
    target, start = TARGETS[name], seeds(name, place / "seed")
    whole = [attempt(target, content, place / "attempt", place / "seed" / "folder") for content in start]
    assert "read" in whole or name == "brdf-merl", whole  # a MERL file in full is 35 MB

    @settings(
        max_examples=inputs, database=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck),
        derandomize=True, deadline=None,
    )  # fmt: skip
    @given(damaged(start))
    def one(content: bytes) -> None:
        attempt(target, content, place / "attempt", place / "seed" / "folder")

    with warnings.catch_warnings(), bounded():
        warnings.simplefilter("ignore")
        one()


@pytest.mark.parametrize("name", [n for n in CHEAP if n not in ("experiment", "preset", "bench")])
def test_a_damaged_file_is_read_or_refused(name: str, tmp_path: Path) -> None:
    hold(name, tmp_path, 60)


@pytest.mark.parametrize("name", ["experiment", "preset", "brdf-netcdf", "mesh-ply", "photograph-exr"])
def test_one_that_takes_longer_is_read_or_refused(name: str, tmp_path: Path) -> None:
    hold(name, tmp_path, 20)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(TARGETS))
def test_many_damaged_files(name: str, tmp_path: Path) -> None:
    hold(name, tmp_path, 300 // TARGETS[name].cost + 5)
