"""The house's rules as functions: each takes a source tree and returns one line per violation."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import house

# Who may import a foreign engine.
DOORS = {
    "mitsuba": ("livlab.model.tracer",),
    "drjit": ("livlab.model.transport", "livlab.model.tracer"),
    "nlopt": ("livlab.optimise",),
    "dask": ("livlab.jobs.scheduler",),
    "distributed": ("livlab.jobs.scheduler",),
    "pickle": (),
    "marshal": (),
    "shelve": (),
}

# What a part of the house may not know although it lies on a lower floor.
SIMULATION = ("livlab.model", "livlab.acquire", "livlab.brdf", "livlab.effects", "livlab.fitting", "livlab.jobs")
REPORTS = re.compile(r"livlab[.](reports|kinds[.]\w+[.]report\w*)")
"""Reports read run folders, those of a kind of experiment too, and never simulate."""
BLIND = {
    REPORTS: (*SIMULATION, "livlab.config", "livlab.optimise", "livlab.stress"),
    re.compile(r"livlab[.]api"): ("livlab.cli",),
    re.compile(r"livlab[.]cli"): ("livlab.api",),
}

INSTRUMENTS = "livlab.acquire.instruments"
ELEMENTS = "livlab.model.tissue.elements"
OWN_BEHAVIOUR = {INSTRUMENTS: INSTRUMENTS, ELEMENTS: "livlab.model.tissue"}
"""Where classes are told by what they do, and the package outside which nobody may ask which of them one is."""

LOOSE_MODULES = 6
MOST_LINES_OF_A_FUNCTION = 60
MOST_POSITIONAL = 8

HEAVY = (
    "drjit",
    "mitsuba",
    "numba",
    "miepython",
    "matplotlib",
    "cv2",
    "skimage",
    "colour",
    "playwright",
    "nlopt",
    "dask",
    "distributed",
    "trimesh",
    "igl",
    "manifold3d",
    "nibabel",
    "nrrd",
    "rawpy",
    "OpenEXR",
    "SALib",
)

MAX_LINES = 400

# Written so that this file does not hold what it looks for.
MACHINE_PATHS = re.compile(
    r"(?<![\w.}~])/(?:[w]ork|[t]mp|[r]oot|[m]nt|[v]ar/folders|[U]sers/\w+|[h]ome/(?!linuxbrew\b)\w+)\b"
)
REGISTRY_HOSTS = re.compile(
    r"\b(?:pypi[.]org|pythonhosted[.]org|anaconda[.]org|npmjs[.]org|crates[.]io|docker[.]io|ghcr[.]io|golang[.]org"
    r"|debian[.]org|archive[.]ubuntu[.]com|ports[.]ubuntu[.]com|brew[.]sh)\b"
)
BINARY = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".nc", ".npz", ".woff2", ".gz", ".zip", ".pdf"}


def within(name: str, package: str) -> bool:
    """Whether a dotted name is the package or lies in it."""
    return name == package or name.startswith(package + ".")


def floor(room: str) -> int | None:
    """On which floor a room lies; None if on none."""
    return next((number for number, rooms in enumerate(house.FLOORS) if room in rooms), None)


def import_violations(root: Path) -> list[str]:
    """Imports that do not run downwards, go around a door, or into what a part should not know."""
    known = house.modules(root)
    found = []
    for name, file in known.items():
        for line, target in _imports(name, file, known):
            where = f"{file.relative_to(root)}:{line}"
            if within(target, "livlab"):
                found += [f"{where}: {trouble}" for trouble in _upward(name, target)]
                for part, unknown in BLIND.items():
                    if part.match(name) and any(within(target, other) for other in unknown):
                        found.append(f"{where}: {name} should not know {target}")
            else:
                engine = target.partition(".")[0]
                if engine in DOORS and not any(within(name, door) for door in DOORS[engine]):
                    found.append(f"{where}: {engine} may be imported by {' or '.join(DOORS[engine]) or 'nobody'} only")
    return found


def _imports(name: str, file: Path, known: Mapping[str, Path]) -> Iterator[tuple[int, str]]:
    """What a module imports; of a face, what it loads at once or in a function, but not what it names for types."""
    named = set()
    if name in house.FACES:
        blocks = [block for block in house.parsed(file.read_text(encoding="utf-8")).body if _for_types(block)]
        named = {node.lineno for block in blocks for node in ast.walk(block) if isinstance(node, ast.stmt)}
    return ((line, target) for line, target in house.imports(name, file, known) if line not in named)


def _upward(name: str, target: str) -> list[str]:
    here, there = house.room(name), house.room(target)
    if here == there or not there:  # its own room; halls and the package itself hold no code
        return [f"{name} imports {target}, which lies above it"] if not there and here else []
    for room in (here, there):
        if room and floor(room) is None:
            return [f"{room} has no floor: give it one in scripts/house.py"]
    below = -1 if not here else floor(here)
    if not here:  # the face of the whole: the ground floors only, everything else when it is asked for
        return [] if floor(there) <= 1 else [f"{name} imports {target}, which lies above it"]
    return [] if floor(there) < below else [f"{name} imports {target}, which lies beside or above it"]


def _for_types(block: ast.stmt) -> bool:
    return isinstance(block, ast.If) and isinstance(block.test, ast.Name) and block.test.id == "TYPE_CHECKING"


def plan_violations(root: Path) -> list[str]:
    """Rooms without a floor, floors without a room, too many modules loose at the top."""
    known = house.modules(root)
    rooms = {house.room(name) for name in known} - {""}
    planned = {room for rooms_of_floor in house.FLOORS for room in rooms_of_floor}
    found = [f"{room} has no floor: give it one in scripts/house.py" for room in sorted(rooms - planned)]
    found += [f"{room} has a floor in scripts/house.py, and is not there" for room in sorted(planned - rooms)]
    loose = [name for name, file in known.items() if file.parent == root / "livlab"]
    if len(loose) > LOOSE_MODULES:
        found.append(f"{len(loose)} modules lie loose at the top, more than {LOOSE_MODULES}: {', '.join(loose)}")
    return found


def names_twice(root: Path) -> list[str]:
    """Public classes of one name in two places."""
    places: dict[str, list[str]] = {}
    for file in house.modules(root).values():
        for node in house.parsed(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(f"{file.relative_to(root)}:{node.lineno}")
    return [f"class {name} is defined {len(x)} times: {', '.join(x)}" for name, x in places.items() if len(x) > 1]


def kind_questions(root: Path) -> list[str]:
    """Places outside an owner's package that ask which instrument or which element one is."""
    known = house.modules(root)
    found = []
    for owned, home in OWN_BEHAVIOUR.items():
        classes = {
            node.name
            for name, file in known.items()
            if within(name, owned)
            for node in house.parsed(file.read_text(encoding="utf-8")).body
            if isinstance(node, ast.ClassDef)
        }
        for name, file in known.items():
            if not within(name, home):
                asked = _asked(house.parsed(file.read_text(encoding="utf-8")), classes)
                found += [f"{file.relative_to(root)}:{line}: asks whether one is {what}" for line, what in asked]
    return found


def _asked(tree: ast.AST, classes: set[str]) -> Iterator[tuple[int, str]]:
    for node in ast.walk(tree):
        named: list[ast.AST] = []
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") in {"isinstance", "issubclass"}:
            named = node.args[1:]
        elif isinstance(node, ast.MatchClass):
            named = [node.cls]
        elif isinstance(node, ast.Compare) and _is_type(node.left):
            named = list(node.comparators)
        for part in named:
            for one in ast.walk(part):
                what = one.id if isinstance(one, ast.Name) else one.attr if isinstance(one, ast.Attribute) else ""
                if what in classes:
                    yield node.lineno, what


def _is_type(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and getattr(node.func, "id", "") == "type"


def long_functions(root: Path) -> list[str]:
    """Functions past the length where a seam should be found, their documentation not counted."""
    found = []
    for file in house.modules(root).values():
        for node in ast.walk(house.parsed(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                said = node.body[0].end_lineno - node.body[0].lineno + 1 if ast.get_docstring(node) else 0
                lines = node.end_lineno - node.lineno + 1 - said
                if lines > MOST_LINES_OF_A_FUNCTION:
                    found.append(f"{file.relative_to(root)}:{node.lineno}: {node.name} has {lines} lines")
    return found


def long_records(root: Path) -> list[str]:
    """Calls and answers of more values than a reader can tell apart by their place."""
    found = []
    for file in house.modules(root).values():
        for node in ast.walk(house.parsed(file.read_text(encoding="utf-8"))):
            count = len(node.args) if isinstance(node, ast.Call) and not _foreign(node.func) else 0
            if isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple):
                count = len(node.value.elts)
            if count > MOST_POSITIONAL:
                found.append(f"{file.relative_to(root)}:{node.lineno}: {count} values told apart by their place")
    return found


def _foreign(function: ast.expr) -> bool:
    """Whether a call is of another library, by its usual short name: it may take no keywords."""
    while isinstance(function, ast.Attribute):
        function = function.value
    return isinstance(function, ast.Name) and function.id in {"cv2", "np", "dr", "mi", "plt"}


def code_from_data_violations(root: Path) -> list[str]:
    """Calls of eval and exec: a config or a data file is never code."""
    found = []
    for file in house.modules(root).values():
        for node in ast.walk(house.parsed(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in {"eval", "exec"}:
                found += [f"{file.relative_to(root)}:{node.lineno}: calls {node.func.id}"]
    return found


def long_modules(root: Path) -> list[str]:
    """Modules past the length where a seam should be found."""
    counts = {file: len(file.read_text(encoding="utf-8").splitlines()) for file in house.modules(root).values()}
    return [f"{file.relative_to(root)}: {count} lines" for file, count in counts.items() if count > MAX_LINES]


def heavy_imports(statement: str, heavy: tuple[str, ...] = HEAVY, folder: Path | None = None) -> list[str]:
    """Heavy packages that are loaded after `statement` ran in a fresh interpreter."""
    code = f"{statement}\nimport sys\nprint(*sorted({set(heavy)!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=folder)
    return done.stdout.split()


def repository_files(root: Path) -> list[Path]:
    """Files that are, or would be, committed; without git everything but hidden folders and caches."""
    command = ["git", "-C", str(root), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    try:
        listed = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split("\0")
        files = [root / name for name in listed if name]
    except (OSError, subprocess.CalledProcessError):
        hidden = re.compile(r"^(\..*|__pycache__|runs|dist|build)$")
        files = [
            file
            for file in root.rglob("*")
            if not any(hidden.match(part) for part in file.relative_to(root).parts[:-1] if part != ".ci")
        ]
    return sorted(file for file in files if file.is_file() and file.suffix.lower() not in BINARY)


def address_violations(root: Path, files: list[Path]) -> list[str]:
    """Lines that name a place on somebody's machine or a package registry's host."""
    found = []
    for file in files:
        for number, line in enumerate(file.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
            for kind, pattern in (("machine path", MACHINE_PATHS), ("registry host", REGISTRY_HOSTS)):
                match = pattern.search(line)
                if match:
                    found.append(f"{file.relative_to(root)}:{number}: {kind} {match.group(0)}")
    return found


def assertless_tests(files: list[Path]) -> list[str]:
    """Tests that cannot fail: no assert, no expected exception, no call of a helper that asserts."""
    found = []
    for file in files:
        tree = house.parsed(file.read_text(encoding="utf-8"))
        functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
        asserting: set[str] = set()
        grown = True
        while grown:  # a helper may assert through another helper
            grown = False
            for function in functions:
                if function.name not in asserting and _asserts(function, asserting):
                    asserting.add(function.name)
                    grown = True
        found += [
            f"{file.name}:{function.lineno}: {function.name} asserts nothing"
            for function in functions
            if function.name.startswith("test") and function.name not in asserting
        ]
    return found


def _asserts(function: ast.AST, asserting: set[str]) -> bool:
    for node in ast.walk(function):
        if isinstance(node, ast.Assert) and not isinstance(node.test, ast.Constant):
            return True
        if isinstance(node, ast.Call):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            expects = isinstance(node.func, ast.Attribute) and called in {"raises", "warns", "fail"}
            if expects or called.startswith("assert") or called in asserting:
                return True
    return False
