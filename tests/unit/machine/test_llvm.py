import json
import os
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from livlab.errors import EnvironmentProblem
from livlab.machine import llvm, llvm_probe

VARIABLE = "DRJIT_LIBLLVM_PATH"


@pytest.fixture
def fresh(monkeypatch, tmp_path):
    """A process that has chosen nothing, found nothing and remembers nothing."""
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setattr(llvm, "_chosen", None)
    monkeypatch.setattr(llvm, "_search", list)
    monkeypatch.setattr(llvm_probe, "_probed", {})
    monkeypatch.setattr(llvm_probe.platformdirs, "user_cache_dir", lambda *_args, **_kwargs: str(tmp_path / "cache"))
    for name in [name for name in sys.modules if name.partition(".")[0] in {"drjit", "mitsuba"}]:
        monkeypatch.delitem(sys.modules, name)
    return tmp_path


def library(folder, name="libLLVM.so.19.1"):
    """A file that looks like the library by its name."""
    file = folder / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(b"not a library")
    return file


def interpreter(folder, script):
    """Stands in for Python: what the probe's process does."""
    file = folder / "python"
    file.write_text(f"#!/bin/sh\necho run >> {folder}/runs\n{script}\n")
    file.chmod(file.stat().st_mode | stat.S_IXUSR)
    return str(file)


def count(folder):
    runs = folder / "runs"
    return len(runs.read_text().splitlines()) if runs.exists() else 0


def old_library():
    """An LLVM 15 or 16 of this machine: the ones that abort the process."""
    found = [path for path, _ in llvm._search() if llvm.major_from_path(path) in (15, 16)]
    if not found:
        pytest.skip("no LLVM 15 or 16 on this machine")
    return found[0]


def in_new_process(code, **environment):
    return subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


def test_the_chosen_library_carries_a_kernel_with_fmaximum(libllvm):
    code = """
from livlab.machine.llvm import choose_libllvm
path = choose_libllvm()
import drjit as dr
from drjit.llvm import Float
print(path, dr.sum(dr.maximum(dr.arange(Float, 8), 5))[0], dr.detail.llvm_version()[0])
"""
    done = in_new_process(code, DRJIT_LIBLLVM_PATH="")
    path, total, major = done.stdout.split()
    assert float(total) == 6 * 5 + 6 + 7
    assert int(major) >= llvm.OLDEST_MAJOR
    assert Path(path).is_file()


def test_an_aborting_llvm_is_refused_before_it_can_abort():
    path = old_library()
    choose = "from livlab.machine.llvm import choose_libllvm; choose_libllvm()"
    done = in_new_process(choose, DRJIT_LIBLLVM_PATH=str(path))
    assert done.returncode == 1
    assert "EnvironmentProblem" in done.stderr
    assert "aborts the process" in done.stderr


def test_an_aborting_llvm_under_an_innocent_name_is_refused_by_its_probe(tmp_path):
    disguised = tmp_path / "libLLVM.so.19.1"
    disguised.symlink_to(old_library())
    verdict, final = llvm_probe._run_probe(disguised)
    assert verdict[0] == "refused"
    assert "signal 6" in verdict[2]
    assert "Cannot select" in verdict[2]
    assert final


def test_no_file_and_no_library_are_refused_with_a_remedy(monkeypatch, fresh):
    monkeypatch.setenv(VARIABLE, str(fresh / "missing.so"))
    with pytest.raises(EnvironmentProblem, match="no such file") as caught:
        llvm.choose_libllvm()
    assert llvm.install_command() in caught.value.remedy
    monkeypatch.setenv(VARIABLE, str(library(fresh)))
    with pytest.raises(EnvironmentProblem, match="the probe kernel failed") as caught:
        llvm.choose_libllvm()
    assert os.environ[VARIABLE] == str(fresh / "libLLVM.so.19.1")


def test_nothing_found_names_the_command(fresh):
    with pytest.raises(EnvironmentProblem, match="No usable libLLVM found") as caught:
        llvm.choose_libllvm()
    assert llvm.install_command() in caught.value.remedy
    assert VARIABLE not in os.environ
    assert llvm.inspect_libllvm() == []


def test_a_refused_wish_names_the_good_one_it_could_have(monkeypatch, fresh):
    good = library(fresh)
    monkeypatch.setattr(sys, "executable", interpreter(fresh, "echo probed 19 1 7"))
    monkeypatch.setattr(llvm, "_search", lambda: [(good, "here")])
    monkeypatch.setenv(VARIABLE, str(library(fresh, "libLLVM-15.so.1")))
    with pytest.raises(EnvironmentProblem, match="LLVM 15 is too old") as caught:
        llvm.choose_libllvm()
    assert caught.value.remedy == f"Unset {VARIABLE}; livlab then takes {good}."


def test_the_order_prefers_what_was_tested(monkeypatch, tmp_path):
    names = [
        "libLLVM.so.21.1",
        "libLLVM-15.so.1",
        "libLLVM-17.so.1",
        "libLLVM.so",
        "libLLVM.so.20.1",
        "libLLVM.so.18.1",
    ]
    for name in [*names, "libLLVM-14.so.1", "libLLVM.so.19.1"]:
        library(tmp_path, name)
    (tmp_path / "libLLVM-19.so").symlink_to(tmp_path / "libLLVM.so.19.1")
    (tmp_path / "libLLVM.a").touch()
    monkeypatch.setattr(llvm, "_PATTERNS", {llvm.platform.system(): (f"{tmp_path}/libLLVM*",)})
    monkeypatch.setattr(llvm.ctypes.util, "find_library", lambda _name: None)
    found = [path for path, _ in llvm._search() if path.parent == tmp_path]
    assert [llvm.major_from_path(path) for path in found] == [19, 20, 18, 17, 21, None, 15, 14]


def test_a_refused_first_choice_makes_way_for_the_next(monkeypatch, fresh):
    first, second = library(fresh), library(fresh, "libLLVM.so.21.1")
    monkeypatch.setattr(llvm, "_search", lambda: [(first, "here"), (second, "here")])
    script = f'case "${VARIABLE}" in *21.1) echo probed 21 1 0;; *) echo broken >&2; exit 91;; esac'
    monkeypatch.setattr(sys, "executable", interpreter(fresh, script))
    assert llvm.choose_libllvm() == second
    assert os.environ[VARIABLE] == str(second)
    assert [found.verdict for found in llvm.inspect_libllvm()] == ["good", "refused"]
    assert "tested with 17, 18, 19, 20 only" in llvm.inspect_libllvm()[0].reason


def test_a_verdict_is_kept_between_processes_until_the_file_changes(monkeypatch, fresh):
    file = library(fresh)
    monkeypatch.setattr(sys, "executable", interpreter(fresh, "echo probed 19 1 7"))
    assert llvm_probe.probe(file) == llvm_probe.probe(file) == ("good", 19, "LLVM 19.1.7 ran the probe kernel")
    assert count(fresh) == 1
    llvm_probe._probed.clear()  # as in another process
    assert llvm_probe.probe(file)[0] == "good"
    assert count(fresh) == 1
    file.write_bytes(b"another build")
    assert llvm_probe.probe(file)[0] == "good"
    assert count(fresh) == 2


@pytest.mark.parametrize("damage", ["", "{", "[]", '{"key": 1}', "forged"])
def test_a_damaged_memory_is_not_believed(monkeypatch, fresh, damage):
    file = library(fresh)
    monkeypatch.setattr(sys, "executable", interpreter(fresh, "echo probed 19 1 7"))
    llvm_probe.probe(file)
    (kept,) = (fresh / "cache" / "libllvm").glob("*.json")
    if damage == "forged":
        record = json.loads(kept.read_text())
        damage = json.dumps({**record, "key": "of another file"})
    kept.write_text(damage)
    llvm_probe._probed.clear()
    assert llvm_probe.probe(file)[0] == "good"
    assert count(fresh) == 2


@pytest.mark.parametrize("place", ["~/.cache/livlab", "/proc/livlab", "/dev/null/livlab"])
def test_a_home_that_cannot_be_written_costs_only_the_memory(monkeypatch, fresh, place):
    monkeypatch.chdir(fresh)
    monkeypatch.setattr(llvm_probe.platformdirs, "user_cache_dir", lambda *_args, **_kwargs: place)
    monkeypatch.setattr(sys, "executable", interpreter(fresh, "echo probed 19 1 7"))
    assert llvm_probe.probe(library(fresh))[0] == "good"
    assert not (fresh / "~").exists()


@pytest.mark.parametrize(
    ("script", "verdict", "said", "kept"),
    [
        ("kill -ABRT $$", "refused", "signal 6", True),
        ("echo 'LLVM ERROR: Cannot select' >&2; echo more >&2; kill -ABRT $$", "refused", "Cannot select", True),
        ("echo wrong sum >&2; exit 91", "refused", "wrong sum", True),
        ("echo RuntimeError: no backend >&2; exit 1", "refused", "no backend", False),
        ("echo ImportError: libatomic.so.1 >&2; exit 90", "unknown", "libatomic", False),
        ("exit 0", "refused", "it said nothing", False),
        ("exec sleep 20", "refused", "did not end", False),
    ],
)
def test_what_a_probe_may_end_in(monkeypatch, fresh, script, verdict, said, kept):
    monkeypatch.setattr(llvm_probe, "PROBE_SECONDS", 1.0)
    monkeypatch.setattr(
        sys, "executable", interpreter(fresh, f"exec sh -c '{script}'" if "sleep" in script else script)
    )
    got = llvm_probe.probe(library(fresh))
    assert got[0] == verdict
    assert said in got[2]
    assert (fresh / "cache" / "libllvm").exists() is kept


def test_a_broken_drjit_is_not_blamed_on_the_library(monkeypatch, fresh):
    file = library(fresh)
    monkeypatch.setattr(llvm, "_search", lambda: [(file, "here")])
    monkeypatch.setattr(
        sys, "executable", interpreter(fresh, "echo 'ImportError: libx.so: no shared object' >&2; exit 90")
    )
    with pytest.raises(EnvironmentProblem, match="importing drjit failed: ImportError") as caught:
        llvm.choose_libllvm()
    assert llvm.install_command() in caught.value.remedy
    llvm_probe._probed.clear()
    monkeypatch.setattr(
        llvm_probe, "version", lambda name: (_ for _ in ()).throw(llvm_probe.PackageNotFoundError(name))
    )
    with pytest.raises(EnvironmentProblem, match="drjit is not installed") as caught:
        llvm.choose_libllvm()
    assert "make setup" in caught.value.remedy


def test_many_threads_get_one_answer_from_one_probe(monkeypatch, fresh):
    file = library(fresh)
    monkeypatch.setattr(llvm, "_search", lambda: [(file, "here")])
    monkeypatch.setattr(sys, "executable", interpreter(fresh, "sleep 0.2; echo probed 19 1 7"))
    answers = []
    threads = [threading.Thread(target=lambda: answers.append(llvm.choose_libllvm())) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert answers == [file] * 8
    assert count(fresh) == 1


def test_a_drjit_imported_earlier_with_a_bad_library_is_told(monkeypatch, fresh):
    monkeypatch.setitem(sys.modules, "drjit", object())
    monkeypatch.setattr(llvm, "_mapped", lambda: library(fresh, "libLLVM-16.so.1"))
    with pytest.raises(EnvironmentProblem, match=r"imported before and has loaded .*LLVM 16 is too old"):
        llvm.choose_libllvm()
    monkeypatch.setattr(llvm, "_mapped", lambda: None)
    with pytest.raises(EnvironmentProblem, match="imported before and found no libLLVM"):
        llvm.choose_libllvm()


def test_a_drjit_imported_earlier_is_told_in_a_real_process(tmp_path):
    code = "import drjit\nfrom livlab.machine.llvm import choose_libllvm\nchoose_libllvm()"
    bad = in_new_process(code, DRJIT_LIBLLVM_PATH=str(library(tmp_path)))
    assert bad.returncode == 1
    assert "imported before" in bad.stderr


def test_a_drjit_imported_earlier_with_a_good_library_is_adopted(libllvm):
    code = "import drjit\nfrom livlab.machine.llvm import choose_libllvm\nprint(choose_libllvm())"
    good = in_new_process(code, DRJIT_LIBLLVM_PATH=str(libllvm))
    assert good.stdout.strip() == str(libllvm)


def test_the_command_to_install_fits_the_system(monkeypatch):
    monkeypatch.setattr(llvm.platform, "system", lambda: "Darwin")
    assert llvm.install_command() == "brew install llvm"
    monkeypatch.setattr(llvm.platform, "system", lambda: "Linux")
    for release, start in [
        ({"ID": "debian"}, "sudo apt-get install -y libatomic1 libllvm19"),
        ({"ID": "pop", "ID_LIKE": "ubuntu debian"}, "sudo apt-get"),
        ({"ID": "rocky", "ID_LIKE": "rhel fedora"}, "sudo dnf"),
        ({"ID": "arch"}, "sudo pacman"),
        ({"ID": "gentoo"}, "install the shared library of LLVM 17"),
    ]:
        monkeypatch.setattr(llvm.platform, "freedesktop_os_release", lambda release=release: release)
        assert llvm.install_command().startswith(start)


def test_what_needs_no_drjit_works_without_any_llvm():
    code = """
import importlib, pkgutil, sys
import livlab
names = [module.name for module in pkgutil.walk_packages(livlab.__path__, "livlab.")]
names = [name for name in names if not name.startswith("livlab.model.tracer")]
for name in names:
    importlib.import_module(name)
assert "drjit" not in sys.modules, "importing livlab imports drjit"
from livlab.datasets import load
from livlab.metrics import rmse
print(len(names), float(load("water_segelstein1981").wavelength_nm[0]), float(rmse([0.0, 3.0], [0.0, 1.0])))
"""
    done = in_new_process(code, DRJIT_LIBLLVM_PATH="/nonexistent/libLLVM.so")
    assert done.returncode == 0, done.stderr
    modules, _, error = done.stdout.split()
    assert int(modules) > 20
    assert float(error) == pytest.approx(2**0.5)
