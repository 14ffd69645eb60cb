"""What a run tells of itself in a terminal: bars with the time left, or plain lines where nobody watches."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, TaskID, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bars

from livlab.runs.work import Progress, Silent


class BarProgress:
    """One bar a task and one for all, each with the time it has taken and has left."""

    def __init__(self, bars: Bars, title: str) -> None:
        self._bars = bars
        self._title = escape(title)
        self._tasks: dict[str, TaskID] = {}
        self._shares: dict[str, float] = {}
        self._overall: TaskID | None = None

    def begin(self, tasks: Sequence[str]) -> None:
        """Draw the bars, empty."""
        self._overall = self._bars.add_task(f"[bold]{self._title}", total=max(1, len(tasks)), text="")
        for task in tasks:
            self._tasks[task] = self._bars.add_task("  " + escape(task), total=1.0, start=False, text="")
            self._shares[task] = 0.0

    def advance(self, task: str, share: float, text: str = "") -> None:
        """Move a task's bar, and the one of all."""
        bar = self._tasks[task]
        if not self._bars.tasks[bar].started:
            self._bars.start_task(bar)
        self._shares[task] = min(1.0, max(share, self._shares[task]))
        self._bars.update(bar, completed=self._shares[task], text=text)
        if self._overall is not None:
            self._bars.update(self._overall, completed=sum(self._shares.values()))

    def say(self, text: str) -> None:
        """Print a line above the bars."""
        self._bars.console.print(text, highlight=False, markup=False)


class PlainProgress:
    """Lines: one when a task begins, one when it is done, and one a few seconds apart between."""

    def __init__(self, console: Console, every_seconds: float = 10.0) -> None:
        self._console = console
        self._every = every_seconds
        self._last = 0.0
        self._begun: dict[str, float] = {}

    def begin(self, tasks: Sequence[str]) -> None:
        """Say nothing yet."""

    def advance(self, task: str, share: float, text: str = "") -> None:
        """Say how far a task is, if that is news."""
        now = time.monotonic()
        first = task not in self._begun
        since = self._begun.setdefault(task, now)
        if not first and share < 1.0 and now - self._last < self._every:
            return
        self._last = now
        left = f", about {(now - since) * (1 - share) / share:.0f} s left" if 0 < share < 1 and not first else ""
        took = f", {now - since:.1f} s" if share >= 1 else ""
        self.say(f"{task}: {math.floor(100 * share)}%{took}{left}{f' ({text})' if text else ''}")

    def say(self, text: str) -> None:
        """Print a line."""
        self._console.print(text, highlight=False, markup=False, soft_wrap=True)


def bars(console: Console) -> Bars:
    """Bars as a run shows them: share, time taken, time left."""
    return Bars(
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[text]}", style="dim", markup=False),
        console=console,
    )


@contextmanager
def watched(title: str, *, quiet: bool) -> Iterator[Progress]:
    """Give the progress that suits the terminal: none if quiet, lines if standard error is no terminal, else bars."""
    console = Console(stderr=True)
    if quiet:
        yield Silent()
    elif not console.is_terminal or not sys.stderr.isatty():
        yield PlainProgress(console)
    else:
        with bars(console) as drawn:
            yield BarProgress(drawn, title)
