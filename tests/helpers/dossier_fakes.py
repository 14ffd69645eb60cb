"""A small folder of experiments with a dossier's file, and run folders made without any simulation."""

from __future__ import annotations

import json
from pathlib import Path

from livlab.criteria import Claim, write_claims
from livlab.dossier.config import load_dossier
from livlab.dossier.validate import Ended, Planned, planned

OPTICS = """
schema = 1
kind = "optics"
name = "{name}"
title = "{title}"

[wavelengths]
list_nm = [500.0, 600.0]

[[chromophore]]
label = "water"
dataset = "water_segelstein1981"
"""

DOSSIER = """
schema = 1
title = "A <small> dossier"
description = "Three experiments & a thesis."

[[unrecorded]]
claim = "seconds*"
why = "Time depends on the machine."

[[group]]
id = "curves"
title = "Curves"
effects = true

[[group.experiment]]
name = "one"
text = "Look at the line."

[group.experiment.figures]
line = "A line that rises."

[[group]]
id = "more"
title = "More"

[[group.experiment]]
name = "two"

[[answer]]
id = "figure-1"
name = "Fig. 1"
title = "A rising line"
shows = "A line without numbers."
deviation = "Ours rises too."

[[answer.show]]
experiment = "one"

[answer.show.figures]
line = "A line that rises."

[[answer.number]]
what = "Its slope"
printed = "2.0"
ours = { experiment = "one", claim = "slope" }

[[answer.number]]
what = "Its start"
printed = "0.5"
unit = "mm"
ours = { experiment = "one", table = "table", column = "start", error = "start_se", where = { reading = "thesis" } }

[[answer.number]]
what = "Its end"
printed = "7"
ours = { experiment = "one", table = "table", column = "start", where = { reading = "nobody's" } }

[[answer]]
id = "figure-2"
name = "Fig. 2"
title = "A photograph"
shows = "A photograph of nothing."
missing = "No experiment takes photographs."

[[answer]]
id = "figure-3"
name = "Fig. 3"
title = "What the second finds"
shows = "Something."

[[answer.show]]
experiment = "two"
"""

SVG = (
    '<?xml version="1.0" encoding="utf-8"?>\n<svg xmlns="http://www.w3.org/2000/svg" width="90pt" height="60pt" '
    'viewBox="0 0 90 60"><g id="axes_1"><path d="M 0 60 L 90 0" style="stroke: #1b1f24"/></g></svg>'
)

CLAIMS = (
    Claim.of("slope", 2.02, 0.01, 2.0, 0.1, seconds=1.5),
    Claim.of("height", 9.0, 0.5, 1.0, 2.0, seconds=2.0),
    Claim.missing("depth", "the <reference> is not to be had", reference=1.0, tolerance=0.1),
    Claim.of("seconds thesis", 5.0, 0.0, 5.0, 5.0),
)


def write_dossier(base: Path, text: str = DOSSIER, names: tuple[str, ...] = ("one", "two", "unlisted")) -> Path:
    """The experiments' folder with its dossier's file; gives the file."""
    folder = base / "experiments"
    (folder / "dossier").mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / f"{name}.toml").write_text(OPTICS.format(name=name, title=f"Experiment {name}"))
    file = folder / "dossier" / "dossier.toml"
    file.write_text(text)
    return file


def write_run(folder: Path, name: str = "one", claims: tuple[Claim, ...] = CLAIMS, **manifest: object) -> Path:
    """A finished run that nobody simulated: a figure, a table, claims, a report."""
    (folder / "figures").mkdir(parents=True)
    (folder / "figures" / "line.svg").write_text(SVG)
    (folder / "table.csv").write_text("reading,start,start_se\nthesis,0.51,0.02\nmeasured,0.7,\n")
    (folder / "plan.csv").write_text("reading,effect,bound,decision,why\nthesis,packaging,0.001,dropped,\n")
    (folder / "config.toml").write_text(f'schema = 1\nname = "{name}"\n')
    write_claims(folder / "claims.csv", claims)
    told = {
        "name": name,
        "kind": "optics",
        "status": "complete",
        "seconds": 12.5,
        "digest": "0" * 12,
        "claim_notes": {c.criterion: c.note for c in claims if c.note},
        "notes": ["one thing to <know>"],
        **manifest,
    }
    (folder / "manifest.json").write_text(json.dumps(told))
    (folder / "report.html").write_text(
        f'<!doctype html><html lang="en"><head><title>{name}</title></head><body><header class="page"><h1>{name}</h1>'
        '</header><h2 id="effects">Effects</h2></body></html>'
    )
    return folder


def ended_three(base: Path) -> tuple[Path, list[Planned], dict[str, Ended]]:
    """One complete, one that failed, one complete without claims, and the dossier's file."""
    file = write_dossier(base)
    experiments = planned(load_dossier(file), file)
    ended = {
        "one": Ended("complete", folder=write_run(base / "runs" / "one"), seconds=12.5, processor_seconds=20.0),
        "two": Ended("failed", "it <broke>: mend it.", seconds=3.0),
        "unlisted": Ended("complete", folder=write_run(base / "runs" / "unlisted", "unlisted", ()), cached=True),
    }
    return file, experiments, ended
