"""Each rule of the house fires on a bad sample, and lets a good one pass."""

import architecture_rules as rules
import house
import pytest


def write(root, name, text):
    file = root / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text, encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("livlab/model/tissue/a.py", "from livlab.model.transport import walk\n", "lies beside or above it"),
        ("livlab/model/transport/a.py", "import livlab.model.tracer.scenes\n", "lies beside or above it"),
        ("livlab/datasets/a.py", "def f():\n    from livlab import cli\n", "lies beside or above it"),
        ("livlab/errors.py", "from livlab import datasets\n", "lies beside or above it"),
        ("livlab/errors.py", "from livlab import units\n", "lies beside or above it"),  # one floor
        ("livlab/acquire/a.py", "from livlab.cli.app import app\n", "lies beside or above it"),
        ("livlab/effects/a.py", "from livlab.fitting.problem import Problem\n", "lies beside or above it"),
        ("livlab/model/tissue/a.py", "from ..transport import walk\n", "lies beside or above it"),
        ("livlab/model/transport/a.py", "def f():\n    import mitsuba as mi\n", "mitsuba may be imported by"),
        ("livlab/acquire/a.py", "import drjit as dr\n", "drjit may be imported by"),
        ("livlab/metrics.py", "import nlopt\n", "nlopt may be imported by"),
        ("livlab/kinds/study/sweep.py", "from dask.distributed import Client\n", "dask may be imported by"),
        ("livlab/jobs/jobs.py", "def f():\n    from distributed import Client\n", "distributed may be imported by"),
        ("livlab/kinds/execute.py", "import pickle\n", "pickle may be imported by nobody"),
        ("livlab/reports/page.py", "from livlab.config import load\n", "should not know"),
        ("livlab/kinds/fit/report.py", "from livlab.model.tissue import optics\n", "should not know"),
        ("livlab/kinds/picture/report_words.py", "from livlab.fitting import fit\n", "should not know"),
        ("livlab/__init__.py", "from livlab.cli.app import app\n", "lies above it"),
        ("livlab/__init__.py", "def f():\n    from livlab.cli.app import app\n", "lies above it"),
        ("livlab/machine/a.py", "if TYPE_CHECKING:\n    from livlab.cli.app import app\n", "lies beside or above it"),
        ("livlab/cli/run.py", "from livlab.api.running import run\n", "should not know"),
        ("livlab/machine/a.py", "from livlab import __version__\n", "has no floor"),
        ("livlab/attic/a.py", "from livlab.units import FloatArray\n", "attic has no floor"),
    ],
)
def test_a_forbidden_import_is_found(tmp_path, name, text, said):
    for package in ("model/transport", "model/tracer", "model/tissue", "datasets", "cli", "reports", "brdf"):
        write(tmp_path, f"livlab/{package}/__init__.py", "")
    for module in ("units", "cli/app", "fitting/fit"):
        write(tmp_path, f"livlab/{module}.py", "")
    write(tmp_path, name, text)
    found = rules.import_violations(tmp_path)
    assert len(found) == 1
    assert said in found[0]
    assert found[0].startswith(name)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("livlab/cli/app.py", "from livlab.model.tracer import scenes\n"),
        (
            "livlab/model/tracer/scenes.py",
            "import mitsuba as mi\nimport drjit as dr\nfrom livlab.model.transport import walk\n",
        ),
        ("livlab/__init__.py", "if TYPE_CHECKING:\n    from livlab.api.running import run as run\n"),
        ("livlab/__init__.py", "from livlab.machine.version import __version__\n"),
        ("livlab/api/run.py", "from livlab.fitting.fit import fit\nfrom livlab.model.tissue import optics\n"),
        ("livlab/optimise/driver.py", "import nlopt\n"),
        ("livlab/jobs/scheduler/dispatch.py", "import dask\nfrom distributed import KilledWorker\n"),
        ("livlab/reports/page.py", "from livlab.runs.files import sha256\nfrom livlab.metrics import rmse\n"),
        ("livlab/kinds/fit/job.py", "from livlab.model.tissue import optics\n"),
        ("livlab/acquire/a.py", "from livlab.model.transport.walk.walk import walk\n"),
    ],
)
def test_an_allowed_import_passes(tmp_path, name, text):
    write(tmp_path, name, text)
    assert rules.import_violations(tmp_path) == []


def test_a_circle_of_files_is_found_wherever_its_imports_hide(tmp_path):
    write(tmp_path, "livlab/brdf/a.py", "def f():\n    from livlab.brdf import b\n")
    write(tmp_path, "livlab/brdf/b.py", "if TYPE_CHECKING:\n    from livlab.brdf.c import C\n")
    write(tmp_path, "livlab/brdf/c.py", "from livlab.brdf.a import f\n")
    write(tmp_path, "livlab/brdf/d.py", "from livlab.brdf.a import f\n")
    write(tmp_path, "livlab/brdf/__init__.py", "")
    found = house.all_circles(tmp_path)
    assert "files import each other in a circle: livlab.brdf.a, livlab.brdf.b, livlab.brdf.c" in found
    assert not any("livlab.brdf.d" in line for line in found)


def test_a_circle_of_packages_is_found_though_no_file_is_in_one(tmp_path):
    write(tmp_path, "livlab/__init__.py", "")
    for name in ("jobs", "runs"):
        write(tmp_path, f"livlab/{name}/__init__.py", "")
    write(tmp_path, "livlab/jobs/a.py", "from livlab.runs.a import x\n")
    write(tmp_path, "livlab/runs/a.py", "")
    write(tmp_path, "livlab/runs/b.py", "from livlab.jobs.b import x\n")
    write(tmp_path, "livlab/jobs/b.py", "")
    assert house.all_circles(tmp_path) == [
        "parts of livlab import each other in a circle: livlab.jobs, livlab.runs",
    ]


def test_no_circle_is_seen_where_there_is_none(tmp_path):
    write(tmp_path, "livlab/__init__.py", "if TYPE_CHECKING:\n    from livlab.api.run import run\n")
    write(tmp_path, "livlab/api/__init__.py", "")
    write(tmp_path, "livlab/api/run.py", "import livlab\nfrom livlab.runs import x\n")
    write(tmp_path, "livlab/runs/__init__.py", "")
    assert house.all_circles(tmp_path) == []


def test_a_room_without_a_floor_and_loose_modules_are_found(tmp_path):
    for number in range(rules.LOOSE_MODULES):
        write(tmp_path, f"livlab/loose{number}.py", "")
    write(tmp_path, "livlab/__init__.py", "")
    found = rules.plan_violations(tmp_path)
    assert "loose0 has no floor: give it one in scripts/house.py" in found
    assert "cli has a floor in scripts/house.py, and is not there" in found
    assert any(line.startswith(f"{rules.LOOSE_MODULES + 1} modules lie loose at the top") for line in found)


def test_a_public_class_of_a_name_that_is_taken_is_found(tmp_path):
    write(tmp_path, "livlab/runs/a.py", "class Plan: ...\nclass _Own: ...\n")
    write(tmp_path, "livlab/runs/b.py", "class Plan: ...\nclass _Own: ...\nclass Other: ...\n")
    assert rules.names_twice(tmp_path) == [
        "class Plan is defined 2 times: livlab/runs/a.py:1, livlab/runs/b.py:1",
    ]


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("def f(x):\n    return isinstance(x, Sphere)\n", "Sphere"),
        ("def f(x):\n    return isinstance(x, (int, base.Sphere))\n", "Sphere"),
        ("def f(x):\n    return isinstance(x, Probe | int)\n", "Probe"),
        ("def f(x):\n    return type(x) is Probe\n", "Probe"),
        ("def f(x):\n    match x:\n        case Blood():\n            return 1\n", "Blood"),
    ],
)
def test_a_question_which_instrument_or_element_one_is_is_found(tmp_path, text, what):
    write(tmp_path, "livlab/acquire/instruments/own.py", "class Sphere: ...\nclass Probe: ...\n")
    write(tmp_path, "livlab/model/tissue/elements/own.py", "class Blood: ...\n")
    write(tmp_path, "livlab/kinds/a.py", text)
    assert [line.endswith(f"asks whether one is {what}") for line in rules.kind_questions(tmp_path)] == [True]


def test_other_questions_are_free(tmp_path):
    write(
        tmp_path,
        "livlab/acquire/instruments/own.py",
        "class Sphere: ...\ndef f(x):\n    return isinstance(x, Sphere)\n",
    )
    write(tmp_path, "livlab/kinds/a.py", "def f(x):\n    return isinstance(x, int) and Sphere() and type(x) is int\n")
    assert rules.kind_questions(tmp_path) == []


def test_a_long_function_is_found_and_its_documentation_is_free(tmp_path):
    most = rules.MOST_LINES_OF_A_FUNCTION
    said = '    """Words.\n' + "    more\n" * most + '    """\n'
    write(tmp_path, "livlab/runs/a.py", "def f():\n" + "    x = 1\n" * most)
    write(tmp_path, "livlab/runs/b.py", "def g():\n" + said + "    x = 1\n" * (most - 1))
    assert rules.long_functions(tmp_path) == [f"livlab/runs/a.py:1: f has {most + 1} lines"]


def test_many_values_told_apart_by_their_place_are_found(tmp_path):
    nine = ", ".join("123456789")
    write(tmp_path, "livlab/runs/a.py", f"x = Record({nine})\ndef f():\n    return {nine}\n")
    write(tmp_path, "livlab/runs/b.py", f"x = Record({nine[:-3]})\ny = cv2.circles({nine})\n")
    assert [line.partition(": ")[0] for line in rules.long_records(tmp_path)] == [
        "livlab/runs/a.py:1",
        "livlab/runs/a.py:3",
    ]


@pytest.mark.parametrize("call", ["eval(text)", "exec(text)"])
def test_running_data_as_code_is_found(tmp_path, call):
    write(tmp_path, "livlab/config/load.py", f"def f(text):\n    return {call}\n")
    write(tmp_path, "livlab/fine.py", "def f(model):\n    return model.eval(3)\n")
    assert rules.code_from_data_violations(tmp_path) == [f"livlab/config/load.py:2: calls {call[:4]}"]


def test_a_long_module_is_found(tmp_path):
    write(tmp_path, "livlab/long.py", "x = 1\n" * (rules.MAX_LINES + 1))
    write(tmp_path, "livlab/short.py", "x = 1\n" * rules.MAX_LINES)
    assert rules.long_modules(tmp_path) == [f"livlab/long.py: {rules.MAX_LINES + 1} lines"]


def test_a_heavy_import_is_found(tmp_path):
    write(tmp_path, "light.py", "def f():\n    import heavy\n")
    write(tmp_path, "loads.py", "import light\nlight.f()\n")
    write(tmp_path, "heavy.py", "")
    assert rules.heavy_imports("import light", ("heavy",), tmp_path) == []
    assert rules.heavy_imports("import loads", ("heavy",), tmp_path) == ["heavy"]


@pytest.mark.parametrize(
    ("line", "kind"),
    [
        ("path = '/" + "work/main'", "machine path"),
        ("see /" + "tmp/x", "machine path"),
        ("/" + "home/ada/livlab", "machine path"),
        ("/" + "Users/ada", "machine path"),
        ("--index-url https://" + "pypi" + ".org/simple", "registry host"),
        ("deb http://deb." + "debian" + ".org bookworm main", "registry host"),
    ],
)
def test_an_address_is_found(tmp_path, line, kind):
    file = write(tmp_path, "docs/a.md", f"fine\n{line}\n")
    found = rules.address_violations(tmp_path, [file])
    assert len(found) == 1
    assert found[0].startswith(f"docs/a.md:2: {kind}")


def test_ordinary_lines_are_no_addresses(tmp_path):
    lines = [
        "/usr/lib/llvm-19",
        "a working tree",
        "home/work",
        "https://doi.org/10.1000/1",
        "frame/work",
        "1/mm",
        "a/tmp",
    ]
    file = write(tmp_path, "a.txt", "\n".join(lines))
    assert rules.address_violations(tmp_path, [file]) == []


def test_without_git_hidden_folders_and_caches_are_passed_over(tmp_path):
    for name in (".venv/a.py", "x/__pycache__/b.py", "runs/c.toml", "figure.png"):
        write(tmp_path, name, "")
    kept = [write(tmp_path, name, "") for name in (".ci/run", "livlab/d.py", ".gitignore")]
    assert rules.repository_files(tmp_path) == sorted(kept)


@pytest.mark.parametrize(
    ("body", "flagged"),
    [
        ("def test_x():\n    f()\n", True),
        ("def test_x():\n    assert True\n", True),
        ("class TestX:\n    def test_x(self):\n        print(1)\n", True),
        ("def test_x():\n    assert f() == 1\n", False),
        ("def test_x():\n    with pytest.raises(ValueError):\n        f()\n", False),
        ("def test_x():\n    np.testing.assert_allclose(1, 1)\n", False),
        ("def low():\n    assert f()\ndef high():\n    low()\ndef test_x():\n    high()\n", False),
        ("def helper():\n    print(1)\ndef test_x():\n    helper()\n", True),
    ],
)
def test_a_test_without_assertion_is_found(tmp_path, body, flagged):
    file = write(tmp_path, "test_sample.py", body)
    assert bool(rules.assertless_tests([file])) is flagged
