import errno
import importlib
import os
import subprocess
import sys
import time

import pytest

from livlab import __version__
from livlab.errors import EnvironmentProblem, InputError

application = importlib.import_module("livlab.cli.app")  # livlab.cli has an object of that name too


def livlab(*arguments, **environment):
    return subprocess.run(
        [sys.executable, "-c", "from livlab.cli import main; main()", *arguments],
        env={**os.environ, "COLUMNS": "100", "NO_COLOR": "1", **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


@pytest.fixture
def failing(monkeypatch):
    """The command line with one command that raises what it is given."""

    def prepare(error):
        def app():
            raise error

        monkeypatch.setattr(application, "app", app)

    return prepare


def test_help_names_every_command():
    done = livlab("--help")
    assert done.returncode == 0
    for command in ("run", "data", "doctor", "schema", "fractions"):
        assert f" {command} " in done.stdout


def test_the_version_is_printed():
    done = livlab("--version")
    assert (done.returncode, done.stdout.strip()) == (0, f"livlab {__version__}")


def test_no_command_shows_the_help():
    done = livlab()
    assert done.returncode == 2
    assert "Usage" in done.stdout + done.stderr


@pytest.mark.parametrize("arguments", [["no-such-command"], ["doctor", "--no-such-option"], ["data", "no-such"]])
def test_a_wrong_call_is_a_usage_error(arguments):
    done = livlab(*arguments)
    assert done.returncode == 2
    assert "no-such" in done.stderr
    assert "Traceback" not in done.stderr


def test_help_is_quick():
    livlab("--help")
    start = time.perf_counter()
    before = os.times().children_user
    assert livlab("--help").returncode == 0
    # processor time: a busy machine does not make the import heavier
    assert os.times().children_user - before < 3.0, f"{time.perf_counter() - start:.1f} s"


def test_an_error_made_on_purpose_is_a_message_and_a_remedy(failing, capsys):
    failing(InputError.of("layers[0].thickness_mm", "[bold]-1", r"must be \[1] " + "x" * 90, "Give [more]."))
    with pytest.raises(SystemExit) as stop:
        application.main()
    lines = capsys.readouterr().err.splitlines()
    assert stop.value.code == 2
    assert lines == [
        r"error: layers[0].thickness_mm = '[bold]-1': must be \[1] " + "x" * 90 + ".",
        "remedy: Give [more].",
    ]


def test_each_kind_of_error_has_its_exit_code(failing, capsys):
    failing(EnvironmentProblem("No usable libLLVM.", remedy=""))
    with pytest.raises(SystemExit) as stop:
        application.main()
    assert stop.value.code == 3
    assert capsys.readouterr().err == "error: No usable libLLVM.\n"


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS, errno.EACCES])
def test_what_the_system_refuses_is_told_plainly(failing, capsys, number):
    failing(OSError(number, os.strerror(number), "runs/x/result.nc"))
    with pytest.raises(SystemExit) as stop:
        application.main()
    first, second = capsys.readouterr().err.splitlines()
    assert stop.value.code == 3
    assert first == f"error: runs/x/result.nc: {os.strerror(number)}."
    assert second.startswith("remedy: ")


def test_memory_that_runs_out_is_told_plainly(failing, capsys):
    failing(MemoryError())
    with pytest.raises(SystemExit) as stop:
        application.main()
    assert stop.value.code == 3
    assert "Out of memory" in capsys.readouterr().err


@pytest.mark.parametrize("error", [KeyError("bug"), OSError(errno.ENOENT, "gone")])
def test_a_defect_keeps_its_traceback(failing, error):
    failing(error)
    with pytest.raises(type(error)):
        application.main()
