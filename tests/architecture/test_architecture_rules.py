"""Each rule of the house fires on a bad sample, and lets a good one pass."""

import architecture_rules as rules
import pytest


def write(root, name, text):
    file = root / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text, encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("livlab/model/tissue/a.py", "from livlab.model.transport import walk\n", "lies above it"),
        ("livlab/model/transport/a.py", "import livlab.model.tracer.scenes\n", "lies above it"),
        ("livlab/datasets/a.py", "def f():\n    from livlab import metrics, cli\n", "lies above it"),
        ("livlab/errors.py", "from livlab import units, datasets\n", "lies above it"),
        ("livlab/acquire/a.py", "from livlab.cli.app import app\n", "lies above it"),
        ("livlab/model/tissue/a.py", "from ..transport import walk\n", "lies above it"),
        ("livlab/model/transport/a.py", "def f():\n    import mitsuba as mi\n", "mitsuba may be imported by"),
        ("livlab/acquire/a.py", "import drjit as dr\n", "drjit may be imported by"),
        ("livlab/metrics.py", "import nlopt\n", "nlopt may be imported by"),
        ("livlab/kinds/study/sweep.py", "from dask.distributed import Client\n", "dask may be imported by"),
        ("livlab/jobs/jobs.py", "def f():\n    from distributed import Client\n", "distributed may be imported by"),
        ("livlab/kinds/execute.py", "import pickle\n", "pickle may be imported by nobody"),
        ("livlab/reports/page.py", "from livlab.model.tissue import optics\n", "should not know"),
        ("livlab/reports/page.py", "from livlab import jobs\n", "should not know"),
        ("livlab/brdf/fit/fit.py", "from livlab.model import tracer\n", "should not know"),
        ("livlab/__init__.py", "from livlab.cli.app import app\n", "lies above it"),
        ("livlab/__init__.py", "def f():\n    from livlab.cli.app import app\n", "lies above it"),
        ("livlab/metrics.py", "if TYPE_CHECKING:\n    from livlab.cli.app import app\n", "lies above it"),
        ("livlab/api/run.py", "from livlab.cli.progress import watched\n", "should not know"),
    ],
)
def test_a_forbidden_import_is_found(tmp_path, name, text, said):
    for package in ("model/transport", "model/tracer", "model/tissue", "datasets", "cli", "reports", "brdf"):
        write(tmp_path, f"livlab/{package}/__init__.py", "")
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
            "import mitsuba as mi\nimport drjit as dr\nfrom livlab.model import transport\n",
        ),
        ("livlab/__init__.py", "if TYPE_CHECKING:\n    from livlab.api.running import run as run\n"),
        ("livlab/api/run.py", "from livlab.fitting.fit import fit\nfrom livlab.model.tissue import optics\n"),
        ("livlab/optimise/driver.py", "import nlopt\n"),
        ("livlab/jobs/scheduler/dispatch.py", "import dask\nfrom distributed import KilledWorker\n"),
        ("livlab/reports/page.py", "from livlab import __version__\nfrom livlab.metrics import rmse\n"),
        ("livlab/acquire/a.py", "from livlab.model.transport.walk.walk import walk\n"),
    ],
)
def test_an_allowed_import_passes(tmp_path, name, text):
    write(tmp_path, name, text)
    assert rules.import_violations(tmp_path) == []


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
