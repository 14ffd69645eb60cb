"""How livlab is built, read off its own imports: rooms, floors, circles, and the plan as a picture.

    python scripts/house.py            writes docs/images/house.svg
    python scripts/house.py --arrows   prints what imports what, room by room

The architecture tests hold the code against `FLOORS`. Everything counts as an import: inside functions, and for type
checkers too. Excepted are faces, packages whose `__init__` only hands on names for users to import.
"""

from __future__ import annotations

import ast
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from xml.sax.saxutils import escape

FLOORS: tuple[tuple[str, ...], ...] = (
    ("errors", "units"),
    ("core", "machine", "metrics", "optimise"),
    ("brdf", "config", "criteria", "curves", "datasets", "model.colour", "model.shapes"),
    ("model.tissue", "runs"),
    ("jobs", "model.transport", "reports"),
    ("model.tracer", "stress"),
    ("acquire",),
    ("effects", "fitting"),
    ("kinds",),
    ("api", "dossier"),
    ("cli",),
)
"""Rooms of the house from the ground up. A room may import what lies on lower floors, nothing beside or above it."""

HALLS = ("model",)
"""Packages that only hold rooms."""

FACES = ("livlab", "livlab.brdf", "livlab.config")
"""What a person imports: their `__init__` hands on names from elsewhere."""

ROOT = Path(__file__).resolve().parents[1]
PICTURE = Path("docs/images/house.svg")

Graph = dict[str, set[str]]


@cache
def parsed(text: str) -> ast.Module:
    """The syntax tree of a module's text; nobody changes it."""
    return ast.parse(text)


def module_name(file: Path, root: Path) -> str:
    """Dotted name of a module below `root`."""
    parts = file.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def modules(root: Path) -> dict[str, Path]:
    """All modules of the package below `root`, by name."""
    return {module_name(file, root): file for file in sorted((root / "livlab").rglob("*.py"))}


def packages(known: Mapping[str, Path]) -> list[str]:
    """Names of those modules that are packages."""
    return [name for name, file in known.items() if file.name == "__init__.py"]


def imports(name: str, file: Path, known: Mapping[str, Path]) -> Iterator[tuple[int, str]]:
    """Line and full name of everything a module imports, inside functions and for type checkers too."""
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(parsed(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*above, base] if base else above)
            for alias in node.names:
                full = f"{base}.{alias.name}"
                yield node.lineno, full if full in known or base == "livlab" else base


def arrows(root: Path) -> Graph:
    """What each module imports of livlab; faces import nothing."""
    known = modules(root)
    graph: Graph = {name: set() for name in known}
    for name, file in known.items():
        if name not in FACES:
            graph[name] |= {to for _, to in imports(name, file, known) if to in known and to != name}
    return graph


def between_children(graph: Graph, package: str) -> Graph:
    """What the direct children of a package import of each other, through whatever lies in them."""
    depth = package.count(".") + 2
    found: Graph = defaultdict(set)
    for name, targets in graph.items():
        if name.startswith(package + "."):
            child = ".".join(name.split(".")[:depth])
            heads = {".".join(to.split(".")[:depth]) for to in targets if to.startswith(package + ".")}
            found[child] |= heads - {child}
    return dict(found)


def circles(graph: Mapping[str, Iterable[str]]) -> list[list[str]]:
    """Groups of names that reach each other (Tarjan 1972), each sorted."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(name: str) -> None:
        index[name] = low[name] = len(index)
        stack.append(name)
        for to in sorted(graph.get(name, ())):
            if to not in index:
                visit(to)
                low[name] = min(low[name], low[to])
            elif to in stack:
                low[name] = min(low[name], index[to])
        if low[name] == index[name]:
            at = stack.index(name)
            group, stack[at:] = stack[at:], []
            if len(group) > 1:
                found.append(sorted(group))

    for name in sorted(graph):
        if name not in index:
            visit(name)
    return found


def all_circles(root: Path) -> list[str]:
    """One line for each circle: of files, and of the children of each package."""
    graph = arrows(root)
    found = [f"files import each other in a circle: {', '.join(group)}" for group in circles(graph)]
    for package in packages(modules(root)):
        groups = circles(between_children(graph, package))
        found += [f"parts of {package} import each other in a circle: {', '.join(group)}" for group in groups]
    return found


def room(name: str) -> str:
    """Which room a module lies in; "" for the package's own face and for halls.

    >>> room("livlab.model.tissue.phase.base"), room("livlab.units"), room("livlab.model")
    ('model.tissue', 'units', '')
    """
    parts = name.split(".")[1:]
    length = 2 if parts and parts[0] in HALLS else 1
    return ".".join(parts[:length]) if len(parts) >= length else ""


def room_arrows(root: Path) -> Graph:
    """What each room imports of other rooms."""
    found: Graph = defaultdict(set)
    for name, targets in arrows(root).items():
        here = room(name)
        if here:
            found[here] |= {room(to) for to in targets} - {here, ""}
    return dict(found)


def needed(graph: Graph) -> Graph:
    """The arrows that do not follow from others (the transitive reduction of a graph without circles)."""

    def reach(name: str) -> set[str]:
        out: set[str] = set()
        left = [name]
        while left:
            fresh = graph.get(left.pop(), set()) - out
            out |= fresh
            left += fresh
        return out

    return {name: {to for to in tos if not any(to in reach(by) for by in tos - {to})} for name, tos in graph.items()}


# --- the picture ---------------------------------------------------------------------------------------------------

WIDTH, ROW, BOX, TOP = 900, 76, 36, 66


def picture(root: Path) -> str:
    """The plan as SVG: floors from the ground up, and the arrows that do not follow from others."""
    graph = room_arrows(root)
    height = TOP + ROW * len(FLOORS) + 34
    place: dict[str, tuple[float, float, float]] = {}
    for number, floor in enumerate(FLOORS):
        y = height - 40 - ROW * number - BOX
        widths = [_wide(name) for name in floor]
        gap = (WIDTH - 40 - sum(widths)) / (len(floor) + 1)
        x = 20.0 + gap
        for name, wide in zip(floor, widths, strict=True):
            place[name] = (x, y, wide)
            x += wide + gap
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" role="img" '
        'font-family="DejaVu Sans, Helvetica, Arial, sans-serif">',
        "<title>How livlab is built: its packages from the ground up, and what imports what</title>",
        f'<rect width="{WIDTH}" height="{height}" fill="#ffffff"/>',
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0 0.8 L7 4 L0 7.2 z" fill="#7a869a"/></marker></defs>',
    ]
    for number in range(len(FLOORS)):
        y = height - 40 - ROW * number + 12
        lines.append(f'<line x1="14" x2="{WIDTH - 14}" y1="{y}" y2="{y}" stroke="#e7eaf0"/>')
    shown = needed(graph)
    for name, box in place.items():
        lines += [_arrow(box, place[to], _slot(shown, place, name, to)) for to in sorted(shown.get(name, ()))]
    for name, (x, y, wide) in place.items():
        fill, edge = ("#fdf1ea", "#c8693f") if name.startswith("model.") else ("#eef3fb", "#4a6ea8")
        lines += [
            f'<rect x="{x:.0f}" y="{y:.0f}" width="{wide:.0f}" height="{BOX}" rx="7" fill="{fill}" stroke="{edge}"/>',
            f'<text x="{x + wide / 2:.0f}" y="{y + 23:.0f}" text-anchor="middle" font-size="15" font-weight="600" '
            f'fill="#1d2733">{escape(name)}</text>',
        ]
    every, few = sum(map(len, graph.values())), sum(map(len, shown.values()))
    lines += [
        '<text x="20" y="26" font-size="15" fill="#1d2733">An arrow means “imports”. All run downwards.</text>',
        f'<text x="20" y="47" font-size="13" fill="#55606f">Of {every} arrows between {len(place)} rooms the {few} are '
        "drawn that do not follow from others.</text>",
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _wide(name: str) -> float:
    return 34 + 9.3 * len(name)


def _slot(shown: Graph, place: Mapping[str, tuple[float, float, float]], name: str, to: str) -> tuple[float, float]:
    """Where along the two boxes an arrow starts and ends (0 to 1), so that arrows of one box stand apart."""

    def centre(other: str) -> float:
        return place[other][0] + place[other][2] / 2

    out = sorted(shown[name], key=centre)
    into = sorted((other for other, tos in shown.items() if to in tos and other in place), key=centre)
    return (out.index(to) + 1) / (len(out) + 1), (into.index(name) + 1) / (len(into) + 1)


def _arrow(start: tuple[float, float, float], end: tuple[float, float, float], slot: tuple[float, float]) -> str:
    x1, y1 = start[0] + start[2] * slot[0], start[1] + BOX
    x2, y2 = end[0] + end[2] * slot[1], end[1] - 2
    bend = min(0.5 * (y2 - y1), 60)
    return (
        f'<path d="M{x1:.0f} {y1:.0f} C{x1:.0f} {y1 + bend:.0f} {x2:.0f} {y2 - bend:.0f} {x2:.0f} {y2:.0f}" '
        'fill="none" stroke="#9aa5b5" stroke-width="1.3" marker-end="url(#tip)"/>'
    )


def main(arguments: list[str]) -> None:
    """Write the picture, or print the arrows."""
    if arguments == ["--arrows"]:
        for name, tos in sorted(room_arrows(ROOT).items()):
            print(f"{name}: {', '.join(sorted(tos)) or '-'}")
        return
    (ROOT / PICTURE).write_text(picture(ROOT), encoding="utf-8")
    print(ROOT / PICTURE)


if __name__ == "__main__":
    main(sys.argv[1:])
