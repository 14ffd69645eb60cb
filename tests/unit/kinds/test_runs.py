"""Run folders: identity, resuming, damage, interruption; with a small job of its own kind."""

from __future__ import annotations

import json
import os
import signal
import sys
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import xarray as xr

from livlab import config as config_module
from livlab.config import Experiment, Kind, to_toml
from livlab.criteria import Claim
from livlab.errors import EnvironmentProblem, Interrupted
from livlab.kinds import execute as runs
from livlab.kinds.execute import execute
from livlab.runs import identity
from livlab.runs.identity import digest, is_complete, read_manifest
from livlab.runs.work import Run

DONE: list[str] = []
HOOK: list[Callable[[Run, int], None]] = []


class Sums(Experiment):
    """Partial sums of the odd numbers, piece by piece."""

    kind: Literal["sums"] = "sums"
    pieces: int = 3
    scale: float = 1.0


def prepare(config: Sums) -> Callable[[Run], None]:
    def work(run: Run) -> None:
        parts = []
        for k in range(config.pieces):
            piece = run.load_piece(f"part {k}")
            if piece is None:
                DONE.append(f"part {k}")
                odd = np.arange(2 * 10 * k + 1, 2 * 10 * (k + 1), 2)
                piece = xr.Dataset({"total": ("one", [config.scale * odd.sum()])})
                run.save_piece(f"part {k}", piece)
            for hook in HOOK:
                hook(run, k)
            run.stop_if_asked()
            parts.append(float(piece["total"].item()))
        run.write_result({"/": xr.Dataset({"total": ("part", parts)})})
        run.write_table("totals.csv", ["part", "total"], [{"part": k, "total": t} for k, t in enumerate(parts)])
        run.write_claims([Claim.of("sum vs square", sum(parts), 0.0, (10 * config.pieces) ** 2 * config.scale, 0.0)])

    return work


@pytest.fixture(autouse=True)
def _sums_kind(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    module = types.ModuleType("sums_kind")
    module.Sums, module.prepare, module.sections = Sums, prepare, lambda run, pictures: []  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "sums_kind", module)
    monkeypatch.setitem(
        config_module.KINDS, "sums", Kind("sums_kind:Sums", "sums_kind:prepare", "sums_kind:sections", "totals")
    )
    DONE.clear()
    HOOK.clear()
    yield
    HOOK.clear()


def sums(**changes: Any) -> Sums:
    return Sums.model_validate({"schema": 1, "name": "sums", **changes})


def run(base: Path, config: Sums | None = None, **options: Any) -> runs.Outcome:
    return execute(config or sums(), base=base, report=False, **options)


def test_a_run_writes_its_folder_and_the_same_experiment_finds_it(tmp_path: Path) -> None:
    first = run(tmp_path, command="livlab run sums.toml")
    assert not first.cached
    assert first.claims[0]["verdict"] == "PASS"
    manifest = read_manifest(first.folder)
    assert first.folder.name == f"sums-{manifest['digest'][:12]}"
    assert manifest["status"] == "complete"
    assert manifest["command"] == "livlab run sums.toml"
    assert set(manifest["files"]) == {"config.toml", "result.nc", "totals.csv", "claims.csv"}
    assert not (first.folder / ".pieces").exists()
    with xr.open_dataset(first.folder / "result.nc") as result:
        assert float(result["total"].sum()) == 900.0
    DONE.clear()
    again = run(tmp_path)
    assert again.cached
    assert again.folder == first.folder
    assert again.claims == first.claims
    assert DONE == []


def test_force_does_it_again_into_the_same_folder(tmp_path: Path) -> None:
    first = run(tmp_path)
    DONE.clear()
    again = run(tmp_path, force=True)
    assert not again.cached
    assert again.folder == first.folder
    assert DONE == ["part 0", "part 1", "part 2"]


@pytest.mark.parametrize("changes", [{"scale": 2.0}, {"seed": 2}, {"pieces": 4}, {"title": "x"}])
def test_a_changed_experiment_has_another_folder(tmp_path: Path, changes: dict[str, Any]) -> None:
    assert run(tmp_path).folder != run(tmp_path, sums(**changes)).folder


def test_the_digest_counts_datasets_and_the_result_version(monkeypatch: pytest.MonkeyPatch) -> None:
    config = sums()
    known = {digest(config, {}), digest(config, {"a": "1"}), digest(config, {"a": "2"}), digest(config, {"b": "1"})}
    assert digest(config, {"a": "1", "b": "2"}) == digest(config, {"b": "2", "a": "1"})
    monkeypatch.setattr(identity, "RESULT_VERSION", identity.RESULT_VERSION + 1)
    assert len(known | {digest(config, {})}) == 5


def test_minus_zero_is_zero_in_the_digest() -> None:
    assert digest(sums(scale=0.0), {}) == digest(sums(scale=-0.0), {})


def test_a_stopped_run_goes_on_from_what_it_saved(tmp_path: Path) -> None:
    HOOK.append(lambda _run, k: os.kill(os.getpid(), signal.SIGINT) if k == 1 else None)
    before = signal.getsignal(signal.SIGINT)  # a shell's background job is started with it ignored
    with pytest.raises(Interrupted, match="what was done is kept") as caught:
        run(tmp_path)
    assert caught.value.exit_code == 130
    assert DONE == ["part 0", "part 1"]
    (folder,) = tmp_path.iterdir()
    assert read_manifest(folder)["status"] == "partial"
    assert not is_complete(folder)
    assert signal.getsignal(signal.SIGINT) is before
    HOOK.clear()
    DONE.clear()
    done = run(tmp_path)
    assert DONE == ["part 2"]
    assert done.claims[0]["verdict"] == "PASS"


def test_a_second_ctrl_c_stops_at_once_and_the_run_still_goes_on_later(tmp_path: Path) -> None:
    def twice(_run: Run, k: int) -> None:
        if k == 1:
            os.kill(os.getpid(), signal.SIGINT)
            os.kill(os.getpid(), signal.SIGINT)
            raise AssertionError("the second signal did not stop it")

    HOOK.append(twice)
    with pytest.raises(Interrupted, match="at once"):
        run(tmp_path)
    HOOK.clear()
    DONE.clear()
    assert run(tmp_path).claims[0]["verdict"] == "PASS"
    assert DONE == ["part 2"]


def interrupted(base: Path) -> Path:
    HOOK.append(lambda r, k: r.stopping.set() if k == 1 else None)
    with pytest.raises(Interrupted):
        run(base)
    HOOK.clear()
    DONE.clear()
    (folder,) = base.iterdir()
    return folder


@pytest.mark.parametrize("damage", ["flip", "cut", "empty", "no seal", "bad seal", "other digest"])
def test_a_damaged_piece_is_found_and_done_again(tmp_path: Path, damage: str) -> None:
    folder = interrupted(tmp_path)
    data = next((folder / ".pieces").glob("part_0*.nc"))
    seal = data.with_suffix(".json")
    raw = bytearray(data.read_bytes())
    if damage == "flip":
        raw[len(raw) // 2] ^= 1
        data.write_bytes(raw)
    elif damage == "cut":
        data.write_bytes(raw[: len(raw) // 2])
    elif damage == "empty":
        data.write_bytes(b"")
    elif damage == "no seal":
        seal.unlink()
    elif damage == "bad seal":
        seal.write_text("[]")
    else:
        seal.write_text(json.dumps({**json.loads(seal.read_text()), "digest": "0"}))
    done = run(tmp_path)
    assert DONE == ["part 0", "part 2"]
    assert done.claims[0]["verdict"] == "PASS"
    noted = [n for n in read_manifest(folder)["notes"] if "part 0" in n]
    assert len(noted) == (0 if damage == "no seal" else 1)


@pytest.mark.parametrize("name", ["result.nc", "claims.csv", "totals.csv", "config.toml", "manifest.json"])
@pytest.mark.parametrize("how", ["gone", "changed"])
def test_a_finished_folder_that_was_tampered_with_is_done_again(tmp_path: Path, name: str, how: str) -> None:
    folder = run(tmp_path).folder
    before = (folder / name).read_bytes()
    if how == "gone":
        (folder / name).unlink()
    else:
        (folder / name).write_bytes(before[:-3] + b"???")
    again = run(tmp_path)
    assert not again.cached
    assert is_complete(folder)
    if name != "manifest.json" and name != "result.nc":
        assert (folder / name).read_bytes() == before


def test_a_write_that_fails_leaves_a_run_that_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import errno

    from livlab.runs import files as runs_files

    real = os.fsync

    def full(descriptor: int) -> None:
        if Path(f"/proc/self/fd/{descriptor}").readlink().name.startswith(".totals."):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(descriptor)

    if not Path("/proc/self/fd").is_dir():
        pytest.skip("needs /proc to tell which file is written")
    with monkeypatch.context() as patch:
        patch.setattr(runs_files.os, "fsync", full)
        with pytest.raises(EnvironmentProblem, match=r"totals\.csv: No space left"):
            run(tmp_path)
    (folder,) = tmp_path.iterdir()
    assert not (folder / "totals.csv").exists()
    assert not list(folder.rglob(".totals.*"))
    assert not is_complete(folder)
    DONE.clear()
    assert run(tmp_path).claims[0]["verdict"] == "PASS"
    assert DONE == []


def test_the_folder_of_another_process_is_left_alone(tmp_path: Path) -> None:
    from livlab.runs.files import locked

    folder = run(tmp_path).folder
    (folder / "claims.csv").unlink()
    import subprocess

    code = (
        "import sys; from pathlib import Path; from livlab.runs.files import locked\n"
        "with locked(Path(sys.argv[1])): print('held', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline().strip() == "held"
        with pytest.raises(EnvironmentProblem, match=f"Another process \\({other.pid}\\)"):
            run(tmp_path)
        other.communicate("")
    with locked(folder):
        pass
    assert not run(tmp_path).cached


def test_the_config_that_a_run_writes_runs_to_the_same_folder(tmp_path: Path) -> None:
    config = sums(scale=0.1, description='line\n"quoted" \\ back')
    first = run(tmp_path, config)
    text = (first.folder / "config.toml").read_text(encoding="utf-8")
    assert text == to_toml(config)
    assert run(tmp_path, config_module.parse_experiment(text)).cached  # type: ignore[arg-type]
