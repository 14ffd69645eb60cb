"""The house's rules as functions: each takes a source tree and returns one line per violation."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

# Imports run downwards: a module may import what has its own rank or a lower one. The longest matching name counts.
RANKS = {
    "livlab": 0,
    "livlab.errors": 0,
    "livlab.core": 0,
    "livlab.config.errors": 0,
    "livlab.units": 0,
    "livlab.datasets": 1,
    "livlab.metrics": 1,
    "livlab.criteria": 1,
    "livlab.machine.gpu": 1,
    "livlab.machine.llvm": 1,
    "livlab.optimise": 1,
    "livlab.machine.llvm_probe": 1,
    "livlab.model": 2,
    "livlab.model.tissue": 2,
    "livlab.model.transport": 3,
    "livlab.model.tracer": 4,
    "livlab.effects": 5,  # a scene has an instrument
    "livlab.api": 6,  # beside the command line, for notebooks
    "livlab.cli": 6,
}
RANK_OF_THE_REST = 5  # study, reports, acquire, brdf, configuration, runs, doctor

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

# What a package may not know although its rank would allow it.
BLIND = {
    "livlab.reports": (
        "livlab.model",
        "livlab.acquire",
        "livlab.brdf",
        "livlab.fitting",
        "livlab.jobs",
        "livlab.config",
    ),
    "livlab.brdf": (
        "livlab.model.tracer",
        "livlab.model.transport",
        "livlab.acquire",
        "livlab.reports",
        "livlab.kinds",
    ),
    "livlab.api": ("livlab.cli",),
    "livlab.cli": ("livlab.api",),
}

# What a person imports: their names come from above when they are asked for, and are named for type checkers only.
FACES = ("livlab", "livlab.brdf")

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


def module_name(file: Path, root: Path) -> str:
    """Dotted name of a module below `root`."""
    parts = file.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def within(name: str, package: str) -> bool:
    """Whether a dotted name is the package or lies in it."""
    return name == package or name.startswith(package + ".")


def rank(name: str) -> int:
    """Height of a module in the house."""
    parts = name.split(".")
    for length in range(len(parts), 1, -1):
        prefix = ".".join(parts[:length])
        if prefix in RANKS:
            return RANKS[prefix]
    return RANKS["livlab"] if name == "livlab" else RANK_OF_THE_REST


def modules(root: Path) -> dict[str, Path]:
    """All modules of the package below `root`."""
    return {module_name(file, root): file for file in sorted((root / "livlab").rglob("*.py"))}


def imports(name: str, file: Path, known: dict[str, Path]) -> Iterator[tuple[int, str]]:
    """Line and full name of everything a module imports, inside functions too; of a face, what it loads at once."""
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    tree = ast.parse(file.read_text(encoding="utf-8"))
    named = {id(node) for block in tree.body if name in FACES and _for_types(block) for node in ast.walk(block)}
    for node in ast.walk(tree):
        if id(node) in named:
            continue
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
                yield node.lineno, full if full in known or (base == "livlab" and alias.name != "__version__") else base


def _for_types(block: ast.stmt) -> bool:
    return isinstance(block, ast.If) and isinstance(block.test, ast.Name) and block.test.id == "TYPE_CHECKING"


def import_violations(root: Path) -> list[str]:
    """Imports that run upwards, around a door, or into what a package should not know."""
    known = modules(root)
    found = []
    for name, file in known.items():
        for line, target in imports(name, file, known):
            where = f"{file.relative_to(root)}:{line}"
            if within(target, "livlab"):
                if rank(target) > rank(name):
                    found.append(f"{where}: {name} imports {target}, which lies above it")
                for package, unknown in BLIND.items():
                    if within(name, package) and any(within(target, other) for other in unknown):
                        found.append(f"{where}: {package} should not know {target}")
            else:
                engine = target.partition(".")[0]
                if engine in DOORS and not any(within(name, door) for door in DOORS[engine]):
                    found.append(f"{where}: {engine} may be imported by {' or '.join(DOORS[engine]) or 'nobody'} only")
    return found


def code_from_data_violations(root: Path) -> list[str]:
    """Calls of eval and exec: a config or a data file is never code."""
    found = []
    for file in modules(root).values():
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in {"eval", "exec"}:
                found += [f"{file.relative_to(root)}:{node.lineno}: calls {node.func.id}"]
    return found


def long_modules(root: Path) -> list[str]:
    """Modules past the length where a seam should be found."""
    counts = {file: len(file.read_text(encoding="utf-8").splitlines()) for file in modules(root).values()}
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
        tree = ast.parse(file.read_text(encoding="utf-8"))
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
