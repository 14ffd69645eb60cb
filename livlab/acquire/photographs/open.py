"""The door to photographs of a sphere: a rig file, a folder that holds one, or a folder in DiLiGenT's layout."""

from __future__ import annotations

from pathlib import Path

from livlab.acquire.photographs.diligent import FILENAMES, load_folder
from livlab.acquire.photographs.rig import PhotographedRig
from livlab.acquire.photographs.rig_file import NAME
from livlab.acquire.photographs.rig_load import load_rig
from livlab.errors import InputError


def open_rig(path: Path) -> PhotographedRig:
    """Photographs named by a `rig.toml`, by a folder that holds one, or by a folder in DiLiGenT's layout.

    Raises
    ------
    InputError
        Nothing of these, or what the loaders refuse.
    """
    if path.is_file():
        return load_rig(path)
    if (path / NAME).is_file():
        return load_rig(path / NAME)
    if (path / FILENAMES).is_file():
        return load_folder(path)
    raise InputError.of(
        "rig",
        str(path),
        f"is no rig file and holds neither {NAME} nor {FILENAMES}",
        f"Name a {NAME}, or a folder in DiLiGenT's layout.",
    )
