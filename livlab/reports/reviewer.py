"""What a reader needs to make a run again: where its numbers came from, on what machine, by which command."""

from __future__ import annotations

import pandas as pd

from livlab.errors import InputError
from livlab.reports.folder import RunData
from livlab.reports.tables import Code, ReportSection, Text, from_frame, number, records

_MADE_WITH = (
    "livlab", "code", "python", "platform", "processor", "cores", "memory_gib", "libllvm", "gpu", "variant", "seed",
    "started",
)  # fmt: skip


def provenance(run: RunData) -> ReportSection:
    """The datasets of a run, and which of them livlab does not bring."""
    section = ReportSection("provenance", "Where every number came from")
    table = run.table("provenance")
    if len(table):
        section.content.append(records(table, "Datasets this run used; each was checked against its hash.", "name"))
    names = run.manifest.get("datasets", {})
    own = [name for name in names if not _brought(name)] if isinstance(names, dict) else []
    if own:
        section.content.append(
            Text(
                f"Not livlab's own: {', '.join(own)}. To make this run again, ask its authors for the folder of each, "
                "with table.csv and meta.toml in it, and put it where LIVLAB_DATA leads."
            )
        )
    return section


def again(run: RunData) -> ReportSection:
    """The commands that make the run again, the machine and the versions it was made with, and the experiment."""
    m = run.manifest
    section = ReportSection("rerun", "How to run it again")
    section.content.append(Code(f"{m.get('command', 'livlab run')}\nlivlab rerun {run.path.name}"))
    section.content.append(
        Text(
            "The first makes it from the experiment's file. The second makes it from this folder's manifest alone, "
            "compares it file by file, and says what is not as it was."
        )
    )
    machine = {key: m[key] for key in _MADE_WITH if m.get(key) not in (None, "") and not isinstance(m[key], dict)}
    frame = pd.DataFrame(
        [(k.replace("_", " "), number(v) if not isinstance(v, str) else v) for k, v in machine.items()],
        columns=["what", "value"],
    )
    section.content.append(from_frame(frame, "The machine and the versions the numbers were made with."))
    packages = m.get("packages", {})
    if packages:
        versions = pd.DataFrame(sorted(packages.items()), columns=["package", "version"])
        section.content.append(from_frame(versions, "Package versions.", folded="Package versions"))
    section.content.append(Code(run.config_text, folded="The experiment in full, every default written out"))
    return section


def _brought(name: object) -> bool:
    """Whether livlab itself brings a dataset of this name."""
    from livlab.datasets.catalogue import is_builtin

    try:
        return is_builtin(str(name))
    except InputError:  # no name that a dataset can have
        return False


__all__ = ["again", "provenance"]
