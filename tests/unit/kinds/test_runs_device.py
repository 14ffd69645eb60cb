"""A variant that needs a GPU is refused where there is none, before a folder is made."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from livlab.config import builtin_experiments, check_experiment
from livlab.errors import EnvironmentProblem
from livlab.kinds.execute import check_device, execute

ASKED = {
    "spectral": "variant",
    "brdf-materials": "variant",
    "brdf-liver-45": "variant",
    "fit-liver": "variant",
    "sensitivity-liver": "variant",
    "liver-healthy": "sampling.variant",
}


@pytest.fixture
def _no_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    import drjit

    real = drjit.has_backend
    monkeypatch.setattr(drjit, "has_backend", lambda kind: kind != drjit.JitBackend.CUDA and real(kind))


def asking(name: str, key: str, value: str = "cuda") -> Any:
    table = tomllib.loads(builtin_experiments()[name].read_text(encoding="utf-8"))
    *path, last = key.split(".")
    place = table
    for step in path:
        place = place.setdefault(step, {})
    place[last] = value
    return check_experiment(table, source=name)


@pytest.mark.usefixtures("_no_gpu")
@pytest.mark.parametrize(("name", "key"), ASKED.items(), ids=list(ASKED))
def test_without_a_gpu_nothing_is_begun(name: str, key: str, tmp_path: Path) -> None:
    with pytest.raises(EnvironmentProblem) as caught:
        execute(asking(name, key), base=tmp_path / "runs", report=False)
    assert caught.value.message == f"{key} = 'cuda': this machine has no NVIDIA GPU, or no driver for it."
    assert f'Set {key} = "llvm"' in caught.value.remedy
    assert not (tmp_path / "runs").exists()


@pytest.mark.usefixtures("_no_gpu")
def test_the_processor_and_the_gpus_of_others_are_not_refused() -> None:
    assert asking("spectral", "variant", "llvm").variant == "llvm"
    check_device(asking("spectral", "variant", "llvm"))
    study = asking("sensitivity-liver", "variant")
    with pytest.raises(EnvironmentProblem):
        check_device(study, "processes:2")
    check_device(study, "tcp://cluster:8786")


def test_where_there_is_a_gpu_it_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    import drjit

    asked = []
    monkeypatch.setattr(drjit, "has_backend", lambda kind: asked.append(kind) is None)
    check_device(asking("spectral", "variant"))
    assert asked == [drjit.JitBackend.CUDA]
