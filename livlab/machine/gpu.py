"""Which NVIDIA GPUs this machine has: by NVIDIA's own library if the extra `gpu` is installed, else by nvidia-smi."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import MutableMapping
from typing import Any

SMI_SECONDS = 10.0


def names() -> list[str]:
    """Name and memory of each GPU; none where the driver does not answer.

    Returns
    -------
    list of str
        "NAME, N MiB".
    """
    found = _by_library()
    return _by_command() if found is None else found


def name_device(info: MutableMapping[str, Any], variant: str) -> None:
    """Enter into a run's account what it ran on.

    Parameters
    ----------
    info
        Gets `variant`, and the libLLVM ("llvm") or the GPU ("cuda") that made it run.
    variant
        "llvm" or "cuda".
    """
    info["variant"] = variant
    if variant == "cuda":
        info["gpu"] = "; ".join(names()) or "unnamed"
        return
    from livlab.machine.llvm import choose_libllvm

    info["libllvm"] = choose_libllvm().name


def _by_library() -> list[str] | None:
    try:
        import pynvml
    except ImportError:
        return None
    try:
        pynvml.nvmlInit()
    except pynvml.NVMLError:
        return None
    try:
        made = []
        for k in range(pynvml.nvmlDeviceGetCount()):
            handle = pynvml.nvmlDeviceGetHandleByIndex(k)
            memory = pynvml.nvmlDeviceGetMemoryInfo(handle).total // 2**20
            made.append(f"{pynvml.nvmlDeviceGetName(handle)}, {memory} MiB")
        return made
    except pynvml.NVMLError:
        return None
    finally:
        pynvml.nvmlShutdown()


def _by_command() -> list[str]:
    smi = shutil.which("nvidia-smi")
    if smi is None:
        return []
    command = [smi, "--query-gpu=name,memory.total", "--format=csv,noheader"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=SMI_SECONDS, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return []
    return done.stdout.strip().splitlines() if done.returncode == 0 else []
