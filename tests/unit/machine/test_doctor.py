import json
import os
import subprocess
import sys
from collections import namedtuple

import pytest
from typer.testing import CliRunner

from livlab.cli.app import app
from livlab.machine import doctor
from livlab.machine.llvm import Libllvm

VARIABLE = "DRJIT_LIBLLVM_PATH"


def states(findings):
    return [finding.state for finding in findings]


def script(file, text):
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f"#!/bin/sh\n{text}\n")
    file.chmod(0o755)
    return str(file)


def run_doctor(*arguments, **environment):
    return subprocess.run(
        [sys.executable, "-c", "from livlab.cli import main; main()", "doctor", *arguments],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=180,
    )


def test_a_sound_machine_passes_in_json(libllvm):
    done = run_doctor("--json", DRJIT_LIBLLVM_PATH="")
    record = json.loads(done.stdout)
    assert done.returncode == 0, done.stdout
    assert record["blocked"] is False
    topics = {finding["topic"] for finding in record["findings"]}
    assert topics == {"Python", "packages", "libLLVM", "variants", "GPU", "cores", "memory", "disk", "kernel cache"}
    ran = [finding["detail"] for finding in record["findings"] if finding["topic"] == "variants"]
    assert "llvm_ad_mono, llvm_ad_spectral run" in ran
    chosen = [finding["detail"] for finding in record["findings"] if finding["detail"].startswith("chosen: ")]
    assert len(chosen) == 1
    assert str(libllvm) in chosen[0]


def test_a_bad_libllvm_blocks_and_is_named():
    done = run_doctor(DRJIT_LIBLLVM_PATH="/nonexistent/libLLVM.so", COLUMNS="200")
    assert done.returncode == 3
    assert "no such file" in done.stdout
    assert "blocked" in done.stdout
    assert "remedy:" in done.stdout
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("package", ["drjit", "mitsuba"])
def test_a_package_that_cannot_be_imported_is_a_finding(tmp_path, package, libllvm):
    broken = tmp_path / package / "__init__.py"
    broken.parent.mkdir()
    broken.write_text("raise ImportError('broken on purpose')\n")
    done = run_doctor(
        "--json",
        DRJIT_LIBLLVM_PATH=str(libllvm),
        PYTHONPATH=str(tmp_path),
        HOME=str(tmp_path),
        XDG_CACHE_HOME=str(tmp_path),
    )
    assert done.returncode == 3, done.stderr
    details = [finding["detail"] for finding in json.loads(done.stdout)["findings"] if finding["state"] != "ok"]
    assert any("broken on purpose" in detail for detail in details)


def test_other_versions_than_tested_are_named(tmp_path):
    pins = tmp_path / "constraints.txt"
    pins.write_text("# a comment\nnumpy==0.0.1  # old\nno-such-package-at-all==1\n")
    findings = doctor.package_findings(pins)
    (warning,) = [finding for finding in findings if finding.state == "warning"]
    assert "numpy" in warning.detail
    assert "tested: 0.0.1" in warning.detail
    assert "no-such-package" not in warning.detail
    assert warning.remedy


def test_versions_as_tested_pass(tmp_path):
    from importlib.metadata import version

    pins = tmp_path / "constraints.txt"
    pins.write_text(f"numpy=={version('numpy')}\n")
    assert states(doctor.package_findings(pins)) == ["ok", "ok"]
    assert doctor.package_findings(pins)[1].detail == "all as tested (1 pinned versions)"


def test_without_pins_that_is_said(monkeypatch):
    monkeypatch.setattr(doctor, "_constraints_file", lambda: None)
    assert doctor.package_findings()[-1].state == "note"


def test_a_missing_package_blocks(monkeypatch):
    monkeypatch.setattr(doctor, "_required", lambda: ["numpy", "no-such-package-at-all"])
    blocked = [finding for finding in doctor.package_findings() if finding.state == "blocked"]
    assert [finding.detail for finding in blocked] == ["not installed: no-such-package-at-all"]
    assert doctor.blocked(blocked)


def test_the_requirements_are_the_package_s_own():
    required = doctor._required()
    assert {"numpy", "mitsuba", "drjit", "xarray"} <= set(required)
    assert "pytest" not in required


def test_an_old_python_blocks(monkeypatch):
    monkeypatch.setattr(doctor, "OLDEST_PYTHON", (99, 0))
    assert states(doctor.python_findings()) == ["blocked"]


def candidate(verdict, origin="search", reason="because"):
    return Libllvm(doctor.Path("/usr/lib/libLLVM.so"), origin, 19, verdict, reason)


@pytest.mark.parametrize(
    ("candidates", "remedy"),
    [
        ([], "Run `install`."),
        ([candidate("refused")], "Run `install`."),
        ([candidate("refused", VARIABLE), candidate("good")], f"Unset {VARIABLE}."),
        ([candidate("refused", VARIABLE), candidate("refused")], "Run `install`."),
        ([candidate("unknown", reason="drjit is not installed")], doctor._SET_UP),
        ([candidate("unknown", reason="cannot open shared object file")], "Run `install`."),
    ],
)
def test_each_llvm_trouble_has_its_remedy(monkeypatch, candidates, remedy):
    monkeypatch.setattr(doctor, "inspect_libllvm", lambda: candidates)
    monkeypatch.setattr(doctor, "install_command", lambda: "install")
    findings = doctor.llvm_findings()
    assert findings[-1].state == "blocked"
    assert findings[-1].remedy == remedy
    assert len(findings) == len(candidates) + 1


def test_a_variant_that_ends_its_process_is_told_from_one_that_ran(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "executable", script(tmp_path / "python", "echo ran one; echo BOOM >&2; kill -ABRT $$"))
    good, bad = doctor.variant_findings(["one", "two"], {}, "blocked")
    assert (good.state, good.detail) == ("ok", "one run")
    assert (bad.state, bad.detail) == ("blocked", "two do not run (signal 6: BOOM)")


def test_a_variant_that_hangs_is_given_up(monkeypatch, tmp_path):
    monkeypatch.setattr(doctor, "VARIANT_SECONDS", 0.5)
    monkeypatch.setattr(sys, "executable", script(tmp_path / "python", "echo ran one; exec sleep 20"))
    findings = doctor.variant_findings(["one", "two"], {}, "warning")
    assert states(findings) == ["ok", "warning"]
    assert "no answer" in findings[1].detail


def test_a_variant_that_computes_wrongly_does_not_pass(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "executable", script(tmp_path / "python", "echo computed-wrong one"))
    assert states(doctor.variant_findings(["one"], {}, "blocked")) == ["blocked"]


def test_gpus_are_listed_and_their_variants_tried(monkeypatch, tmp_path):
    script(tmp_path / "nvidia-smi", "echo 'Some GPU, 8192 MiB'; echo 'Other GPU, 4096 MiB'")
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setattr(sys, "executable", script(tmp_path / "python", "echo 'no driver' >&2; exit 1"))
    gpu, variants = doctor.cuda_findings()
    assert gpu.detail == "Some GPU, 8192 MiB; Other GPU, 4096 MiB"
    assert (variants.state, "no driver" in variants.detail) == ("warning", True)


def test_a_driver_that_fails_is_a_warning(monkeypatch, tmp_path):
    script(tmp_path / "nvidia-smi", "echo failed; exit 9")
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    assert states(doctor.cuda_findings()) == ["warning"]


def test_no_gpu_is_only_a_note(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(doctor.ctypes.util, "find_library", lambda _name: None)
    assert states(doctor.cuda_findings()) == ["note"]


def test_little_memory_and_a_full_disk_are_warnings(monkeypatch, tmp_path):
    import psutil

    memory, disk = namedtuple("memory", "available total"), namedtuple("disk", "free")
    monkeypatch.setattr(psutil, "virtual_memory", lambda: memory(1 << 30, 2 << 30))
    monkeypatch.setattr(doctor.shutil, "disk_usage", lambda _place: disk(100 << 20))
    findings = {finding.topic: finding for finding in doctor.machine_findings(tmp_path)}
    assert findings["memory"].detail == "1.0 GiB free of 2.0 GiB"
    assert (findings["memory"].state, findings["disk"].state) == ("warning", "warning")
    assert all(finding.remedy for finding in findings.values() if finding.state == "warning")


@pytest.mark.parametrize(
    ("environment", "state"),
    [
        ({}, "warning"),
        ({"HOME": "/proc/nowhere"}, "warning"),
        ({"DRJIT_CACHE_DIR": "/dev/null/kernels"}, "warning"),
        ({"HOME": "HERE"}, "ok"),
        ({"HOME": "/proc/nowhere", "DRJIT_CACHE_DIR": "HERE/not/yet/there"}, "ok"),
    ],
)
def test_the_kernel_cache_needs_a_writable_folder(monkeypatch, tmp_path, environment, state):
    for name in ("HOME", "DRJIT_CACHE_DIR"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value.replace("HERE", str(tmp_path)))
    (finding,) = doctor.cache_findings()
    assert finding.state == state
    assert bool(finding.remedy) is (state == "warning")


@pytest.mark.parametrize(
    ("found", "code", "last"),
    [
        (["ok"], 0, "Everything livlab needs is here."),
        (["ok", "note", "warning"], 0, "Simulations can run; 1 warning."),
        (["blocked", "warning"], 3, "2 troubles; simulations cannot run before the red ones are mended."),
    ],
)
def test_the_exit_code_says_whether_something_blocks(monkeypatch, found, code, last):
    findings = [doctor.Finding("thing", state, "a [bracket] detail", "") for state in found]
    monkeypatch.setattr(doctor, "examine", lambda: findings)
    result = CliRunner().invoke(app, ["doctor"])
    assert result.exit_code == code
    assert result.stdout.rstrip().endswith(last)
    assert "a [bracket] detail" in result.stdout
