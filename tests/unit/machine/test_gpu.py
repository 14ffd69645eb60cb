"""Naming the device: by NVIDIA's library where it is installed and answers, else by nvidia-smi, else not at all."""

import os
import sys
from types import SimpleNamespace

import pytest

from livlab.machine import gpu


class NVMLError(Exception):
    """As NVIDIA's library raises it."""


def library(**changes):
    closed = []
    made = {
        "NVMLError": NVMLError,
        "nvmlInit": lambda: None,
        "nvmlDeviceGetCount": lambda: 2,
        "nvmlDeviceGetHandleByIndex": lambda k: k,
        "nvmlDeviceGetName": lambda k: ("First GPU", "Second GPU")[k],
        "nvmlDeviceGetMemoryInfo": lambda k: SimpleNamespace(total=(8 + k) * 2**30),
        "nvmlShutdown": lambda: closed.append(True),
    }
    return SimpleNamespace(**(made | changes), closed=closed)


@pytest.fixture
def smi(monkeypatch, tmp_path):
    path = tmp_path / "nvidia-smi"
    path.write_text("#!/bin/sh\necho 'Told GPU, 4096 MiB'\n")
    path.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)


def fails(*_):
    raise NVMLError("driver not loaded")


def test_the_library_names_them(monkeypatch):
    found = library()
    monkeypatch.setitem(sys.modules, "pynvml", found)
    assert gpu.names() == ["First GPU, 8192 MiB", "Second GPU, 9216 MiB"]
    assert found.closed == [True]


@pytest.mark.parametrize("broken", ["nvmlInit", "nvmlDeviceGetCount", "nvmlDeviceGetName"])
def test_a_library_without_answer_leaves_it_to_the_command(monkeypatch, smi, broken):
    monkeypatch.setitem(sys.modules, "pynvml", library(**{broken: fails}))
    assert gpu.names() == ["Told GPU, 4096 MiB"]


def test_without_the_library_the_command_tells(monkeypatch, smi):
    monkeypatch.setitem(sys.modules, "pynvml", None)
    assert gpu.names() == ["Told GPU, 4096 MiB"]


def test_without_either_there_are_none(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "pynvml", None)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert gpu.names() == []


def test_a_run_says_which_gpu_or_which_libllvm(monkeypatch):
    monkeypatch.setattr(gpu, "names", lambda: ["Some GPU, 8192 MiB"])
    info = {}
    gpu.name_device(info, "cuda")
    assert info == {"variant": "cuda", "gpu": "Some GPU, 8192 MiB"}
    info = {}
    gpu.name_device(info, "llvm")
    assert info["variant"] == "llvm"
    assert "LLVM" in info["libllvm"]
