"""The recording walk: the kernel of `walk` with an observer that writes one row a photon that leaves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.device import Device, Variant
from livlab.model.transport.ledger.data import Entries, bins_of, sort_entries
from livlab.model.transport.source import Source
from livlab.model.transport.tally import SampleMoments, Tally
from livlab.model.transport.walk.columns import Columns, Settings
from livlab.model.transport.walk.kernel import trace
from livlab.model.transport.walk.observers import End, Step
from livlab.model.transport.walk.tables import tables

CAPTURE_WEIGHT = 0.5
LANES: dict[Variant, int] = {"llvm": 1 << 11, "cuda": 1 << 18}
"""Walkers in flight. Fewer than the plain walk's: a lane's rows need no room in registers, and what is in flight
stays in the first cache."""

LANE_SHARE = 48
"""Photons a lane should walk at least, so that the longest walk does not keep the others waiting."""

ROWS_PER_LAUNCH = 1 << 21
_HEAD = 4
_VECTOR = 16


class Record:
    """Path length a layer and scatterings a counted layer, written where and how a photon ends.

    A lane writes to its own part of memory, one row after the other: the order does not depend on threads.
    """

    def __init__(self, d: Device, layers: int, counted: tuple[int, ...], lanes: int, slots: int) -> None:
        self._layers, self._counted, self._slots = layers, counted, slots
        self.width = _HEAD + layers + len(counted)
        self._first = d.dr.arange(d.UInt32, lanes) * d.dr.opaque(d.UInt32, slots)
        self.rows = d.dr.zeros(d.Float, lanes * slots * self.width)
        d.dr.make_opaque(self._first, self.rows)

    def start(self, d: Device, lanes: int) -> Any:
        """Nothing walked, nothing written."""
        zero = [d.dr.zeros(d.Float, lanes) for _ in range(self._layers + len(self._counted))]
        return tuple(zero[: self._layers]), tuple(zero[self._layers :]), d.dr.zeros(d.UInt32, lanes)

    def step(self, d: Device, state: Any, step: Step) -> Any:
        """Add the step to the layer it lies in."""
        paths, counts, slot = state
        paths = tuple(d.dr.select(here, x + step.path, x) for here, x in zip(step.inside, paths, strict=True))
        counts = tuple(
            d.dr.select(step.inside[k] & step.met, x + 1.0, x) for k, x in zip(self._counted, counts, strict=True)
        )
        return paths, counts, slot

    def end(self, d: Device, state: Any, end: End) -> Any:
        """Write a row for photons that left or were given up, and clear what belongs to any that ended."""
        dr = d.dr
        paths, counts, slot = state
        code = dr.select(end.up, d.Float(1.0), dr.select(end.down, d.Float(2.0), d.Float(3.0)))
        code = dr.select(end.stopped, d.Float(4.0), code)
        kept = (end.up | end.down | end.side | end.stopped) & (end.weight > 0.0)
        radius = end.radius if end.radius is not None else d.Float(0.0)

        def write(kept: Any, index: Any, values: Any) -> Any:
            for k, value in enumerate(values):
                dr.scatter(self.rows, value, index + k, kept)
            return kept

        index = (self._first + slot) * self.width
        args = (kept, index, (code, end.weight, end.cosine, radius, *paths, *counts))
        dr.if_stmt(args, kept, write, lambda kept, *_: kept)
        clear = tuple(tuple(dr.select(end.done, 0.0, x) for x in group) for group in (paths, counts))
        return clear[0], clear[1], slot + dr.select(kept, d.UInt32(1), d.UInt32(0))

    def result(self, d: Device, state: Any, wavelengths: int, samples: int) -> dict[str, SampleMoments]:
        """No sums: see `rows`."""
        return {}


@dataclass
class Recorder:
    """A reference stack on the device, ready for one launch after the other.

    Attributes
    ----------
    walked
        The reference stack, one wavelength an anchor.
    counted
        Layers whose scatterings are counted.
    positions
        Whether the place of exit is recorded.
    """

    d: Device
    walked: OpticalStack
    counted: tuple[int, ...]
    source: Source
    tally: Tally
    half_width_mm: float | None
    positions: bool
    max_steps: int
    capture_weight: float = CAPTURE_WEIGHT

    def __post_init__(self) -> None:
        self._tables = tables(self.walked, "expected")
        steered = self._tables.shape.redirects != (0,) and self._tables.shape.steered
        space = self.positions or self.half_width_mm is not None or steered
        self._settings = Settings(self.source, self.half_width_mm, self.capture_weight, self.max_steps, space)
        self._columns: Columns | None = None
        self._batch = 0

    @property
    def most(self) -> int:
        """Photons an anchor that one launch can hold."""
        return max(1, ROWS_PER_LAUNCH // len(self.walked.wavelength_nm))

    def launch(self, photons: int, seed: int) -> tuple[Entries, float]:
        """Rows of so many photons an anchor, and the seconds spent on compiling."""
        d, dr = self.d, self.d.dr
        anchors = len(self.walked.wavelength_nm)
        wanted = max(1, min(LANES[d.variant] // anchors, photons // LANE_SHARE))
        each = math.ceil(wanted / _VECTOR) * _VECTOR
        if self._columns is None or self._columns.per_wavelength != each:
            self._columns = Columns(d, self._tables, self._settings, each)
        slots = photons // each + 1
        record = Record(d, self._tables.shape.layers, self.counted, each * anchors, slots)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            trace(self._columns, self._settings, [record], photons, seed, self._batch)
            spent = sum(h.get("codegen_time", 0.0) + h.get("backend_time", 0.0) for h in dr.kernel_history())
        self._batch += 1
        table = np.asarray(record.rows.numpy()).reshape(-1, record.width)
        found = np.flatnonzero(table[:, 0])
        rows = table[found]
        cosine, radius = rows[:, 2], rows[:, 3]
        entries = Entries(
            anchor=(found // (each * slots)).astype(np.uint16),
            side=(rows[:, 0] - 1.0).astype(np.uint8),
            bin=bins_of(self.tally, cosine, radius),
            features=np.ascontiguousarray(rows[:, _HEAD:]),
            log_weight=np.log(rows[:, 1]),
            concentration=np.ones(len(rows), dtype=np.float32),
            cosine=np.ascontiguousarray(cosine),
            radius=np.ascontiguousarray(radius) if self.positions else np.empty(0, dtype=np.float32),
        )
        return sort_entries(entries), 1e-3 * spent


def join(parts: list[Entries]) -> Entries:
    """Rows of several launches."""
    names = parts[0].arrays()
    return sort_entries(Entries(**{n: np.concatenate([getattr(p, n) for p in parts]) for n in names}))
