"""A kind, an instrument, an element and a file format are each added by one file or folder and one row, and work.

They are added to a copy of the package, so that nothing of the house is touched, and used there by a new process.
"""

import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import pytest

ROOT = Path(__file__).resolve().parents[2]

FILES = {
    # A kind of experiment: one folder.
    "livlab/kinds/toy/__init__.py": '"""A toy."""\n',
    "livlab/kinds/toy/config.py": '''
        """What a toy's file says."""

        from typing import Literal

        from pydantic import Field

        from livlab.config.schema import Experiment


        class ToyExperiment(Experiment):
            """Squares of whole numbers."""

            kind: Literal["toy"] = "toy"
            count: int = Field(3, ge=1, le=100, description="How many.")
        ''',
    "livlab/kinds/toy/job.py": '''
        """The toy's job."""

        from livlab.criteria import Claim


        def prepare(config):
            """Square some numbers."""
            rows = [{"n": n, "square": n * n} for n in range(config.count)]
            claims = [Claim.of("square of two", 4.0, 0.0, 4.0, 0.1)]
            costs = (("stage", "seconds"), [{"stage": "squares", "seconds": 0.0}])
            return lambda run: run.finish(claims, {"squares.csv": (("n", "square"), rows)}, costs)
        ''',
    "livlab/kinds/toy/report.py": '''
        """What a toy's report shows."""

        from livlab.reports.tables import ReportSection, from_frame


        def sections(run, pictures):
            """The squares."""
            return [ReportSection("squares", "Squares of a toy", [from_frame(run.table("squares"), "All of them.")])]
        ''',
    # An instrument: one file. It has a size, and loses what leaves through its sides.
    "livlab/acquire/instruments/toy.py": '''
        """A toy: a square sample of 1 mm under a pencil, all that leaves is read."""

        import math
        from typing import Literal

        import numpy as np
        from pydantic import Field

        from livlab.acquire.instruments.base import Edge, Extent, VirtualInstrument, half_mm
        from livlab.model.transport.geometry import Readout
        from livlab.model.transport.source import Source
        from livlab.model.transport.tally import Tally


        class Toy(VirtualInstrument):
            """A toy."""

            kind: Literal["toy"] = "toy"
            side_mm: Extent = Field(1.0, description="Side of the sample.")

            def readout(self, n_above):
                """All of it."""
                return Readout(Source.collimated(), Tally(), half_mm(self.side_mm), np.ones((1, 1)), 1.0, True)

            def edges(self):
                """Four sides."""
                half = half_mm(self.side_mm)
                return () if half is None else (Edge(half, 4, half),)

            def endless(self):
                """Without them."""
                return self.model_copy(update={"side_mm": "infinite"})

            @property
            def lateral_distance(self):
                """None."""
                return ""

            def endless_notes(self):
                """None."""
                return []

            @classmethod
            def cases(cls):
                """None."""
                return ()
        ''',
    # An element of tissue: one file.
    "livlab/model/tissue/elements/toy.py": '''
        """A toy: it absorbs the same at every wavelength."""

        from typing import ClassVar, Literal

        import numpy as np
        from pydantic import Field

        from livlab.model.tissue.elements.base import Absorber, MovableAbsorption, ReferenceValue, Slider


        class Toy(Absorber):
            """A grey absorber."""

            kind: Literal["toy"]
            strength_per_cm: float = Field(description="Its absorption.", ge=0.0)

            units: ClassVar[dict[str, str]] = {"strength_per_cm": "1/cm"}

            def dataset_names(self):
                """None."""
                return ()

            def absorption(self, setting):
                """The same everywhere."""
                return np.full(len(setting.wavelength_nm), self.strength_per_cm / 10.0)

            def omissions(self):
                """None."""
                return ()

            def movable_absorption(self, name, setting):
                """By its strength."""
                slider = Slider("strength_per_cm", "toy", 0.0, 10.0, self.strength_per_cm, unit="1/cm")
                one = np.full(len(setting.wavelength_nm), 0.1)
                data = {"key": "strength_per_cm", "spectrum": one}
                return MovableAbsorption("pigment", data, (slider,), self.absorption(setting))

            @classmethod
            def reference_values(cls):
                """Ten per centimetre are one per millimetre."""
                return (ReferenceValue("unit", {"strength_per_cm": 10.0}, 1.0, 0.0),)
        ''',
    # A BRDF file format: one file.
    "livlab/brdf/files/toy.py": '''
        """A toy: seven numbers a line, both directions and the value."""

        from livlab.brdf.files.interface import FileFunctions
        from livlab.brdf.samples import sample_dataset


        def read(path):
            """Lines of seven."""
            rows = [[float(x) for x in line.split()] for line in path.read_text().splitlines()]
            return sample_dataset([r[:3] for r in rows], [r[3:6] for r in rows], [r[6:] for r in rows])


        FILE = FileFunctions(read)
    ''',
}

# One row each, below a row that is there (and the import that a table of classes needs).
ROWS = [
    (
        "livlab/config/kinds.py",
        "KINDS: dict[str, Kind] = {\n",
        '    "toy": Kind("livlab.kinds.toy.config:ToyExperiment", "livlab.kinds.toy.job:prepare",'
        ' "livlab.kinds.toy.report:sections", "squares"),\n',
        "",
    ),
    (
        "livlab/acquire/instruments/models.py",
        "    HyperspectralCamera,\n",
        "    Toy,\n",
        "from livlab.acquire.instruments.toy import Toy\n",
    ),
    (
        "livlab/brdf/models/lobes.py",
        '        Lobe("lambert", "Lambert 1760", (KD,), _lambert, "kd", f"matt surfaces; {UPPER}"),\n',
        '        Lobe("toy", "nobody", (KD,), _lambert, "kd", "a toy"),\n',
        "",
    ),
    (
        "livlab/brdf/files/registry.py",
        "    for row in (\n",
        '        Format("toy", (".toy",), "livlab.brdf.files.toy", "seven numbers a line", "others", written=False),\n',
        "",
    ),
    (
        "livlab/model/tissue/elements/__init__.py",
        "    PublishedScatterer,\n",
        "    Toy,\n",
        "from livlab.model.tissue.elements.toy import Toy\n",
    ),
]

USE = """
    import json
    from pathlib import Path

    import numpy as np

    import livlab
    from livlab.brdf.samples import sample_dataset
    from livlab.model.tissue.optics import coefficients
    from livlab.model.tissue.readings import reading

    # The kind: run, opened, reported.
    run = livlab.run({"name": "mine", "kind": "toy", "count": 4}, out="runs")
    told = {"table": run.to_pandas().to_dict("list"), "claims": [c.verdict for c in run.claims]}
    told["report"] = "Squares of a toy" in (run.folder / "report.html").read_text(encoding="utf-8")

    # The element: in a layer among the others.
    grid = [550.0, 650.0]
    changes = {"layers.parenchyma.elements.grey": {"kind": "toy", "strength_per_cm": 5.0}}
    plain = livlab.tissue("liver", variant="parenchyma_only")
    grey = livlab.tissue("liver", variant="parenchyma_only", changes=changes)
    found = coefficients(grey, reading("consistent"), np.array(grid))
    told["grey"] = found["absorption"].sel(element="grey", layer="parenchyma").values.tolist()

    # The instrument: a finite sample loses light at its sides, an endless one does not.
    told["sides"] = [
        livlab.spectrum(
            plain, "consistent", grid, instrument={"kind": "toy", "side_mm": side}, accuracy=0.01, solver="walk"
        ).value.tolist()
        for side in (1.0, "infinite")
    ]

    # The lobe: fitted to what it is.
    up = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, 0.6, 0.8]])
    samples = sample_dataset(up, up[::-1].copy(), np.full((3, 1), 0.25))
    told["lobe"] = livlab.brdf.fit_model(samples, "toy", bootstrap=None).values

    # The format: read, and converted by the command.
    Path("mine.toy").write_text("0 0 1 0 0 1 0.25\\n0.6 0 0.8 0 0 1 0.2\\n")
    told["read"] = livlab.brdf.read("mine.toy")["value"].values.ravel().tolist()
    livlab.brdf.write("mine.csv", livlab.brdf.read("mine.toy"))
    told["written"] = livlab.brdf.read("mine.csv")["value"].values.ravel().tolist()
    print(json.dumps(told))
"""


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    home = tmp_path_factory.mktemp("grown")
    shutil.copytree(ROOT / "livlab", home / "livlab", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("datasets", "experiments"):
        (home / name).symlink_to(ROOT / name)
    for name, text in FILES.items():
        file = home / name
        file.parent.mkdir(exist_ok=True)
        file.write_text(dedent(text).lstrip(), encoding="utf-8")
    for name, above, row, imported in ROWS:
        file = home / name
        text = file.read_text(encoding="utf-8")
        assert text.count(above) == 1, f"{name} has no single row {above!r}"
        text = text.replace(above, above + row)
        if imported:
            first = text.index("from livlab.")
            text = text[:first] + imported + text[first:]
        file.write_text(text, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", dedent(USE)],
        cwd=home,
        env={**os.environ, "PYTHONPATH": str(home)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_kind_of_experiment_runs_answers_and_reports(told):
    assert told["table"] == {"n": [0, 1, 2, 3], "square": [0, 1, 4, 9]}
    assert told["claims"] == ["PASS"]
    assert told["report"] is True


def test_an_element_adds_what_it_says(told):
    assert told["grey"] == pytest.approx([0.5, 0.5])


def test_an_instrument_of_finite_size_loses_light_at_its_sides(told):
    finite, endless = told["sides"]
    assert all(0.0 < one < 0.9 * other for one, other in zip(finite, endless, strict=True))


def test_a_lobe_is_fitted(told):
    assert list(told["lobe"].values()) == [pytest.approx(0.25 * math.pi)]


def test_a_file_format_is_read_and_converted(told):
    assert told["read"] == told["written"] == [0.25, 0.2]
