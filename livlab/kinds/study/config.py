"""The study experiment: what a tissue's curve owes to its values, to the readings' choices and to its effects."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
from livlab.acquire.instruments.models import Instrument
from livlab.acquire.instruments.solvers import AddingDoublingSolver, AutoSolver, WalkSolver
from livlab.config.errors import nearest
from livlab.config.schema import Experiment
from livlab.errors import InputError
from livlab.kinds.shared.sections import Reference, Wavelengths
from livlab.kinds.study.config_parts import Ablation, Factor, LedgerSolver, Output, Sensitivity, StudyCriterion, Sweep
from livlab.model.tissue.presets import TissueSpec
from livlab.model.tissue.readings import READINGS, Reading

Method = Literal["sweep", "sensitivity", "ablation"]
StudySolver = Annotated[WalkSolver | AddingDoublingSolver | AutoSolver | LedgerSolver, Field(discriminator="kind")]
"""How the light is followed at each point; a ledger follows it once for many."""


class StudyExperiment(Experiment):
    """A sweep, a sensitivity analysis or an ablation of a tissue under an instrument."""

    kind: Literal["study"] = "study"
    method: Method = Field(description="sweep: a table of points; sensitivity: indices; ablation: one by one.")
    tissue: TissueSpec = Field(default_factory=TissueSpec, description="The tissue, with what does not vary.")
    reading: Reading = Field(default=READINGS["measured"], description="How the tissue is read where it does not vary.")
    wavelengths: Wavelengths = Field(description="Where the curve is sampled.")
    instrument: Instrument = Field(
        default=HyperspectralCamera(polarisation="crossed"), description="What looks at the tissue."
    )
    solver: StudySolver = Field(default_factory=AddingDoublingSolver, description="How light is followed.")
    variant: Literal["llvm", "cuda"] = Field("llvm", description="Where a walk or a ledger runs.")
    normalise: Literal["max", "sum", "none"] = Field(
        "max", description="Both curves over their maximum or sum, or as they are, before they are compared."
    )
    factor: tuple[Factor, ...] = Field((), strict=False, max_length=40, description="What varies.")
    reference: tuple[Reference, ...] = Field((), strict=False, description="Measured curves to compare with.")
    output: tuple[Output, ...] = Field(strict=False, min_length=1, max_length=40, description="What is looked at.")
    sweep: Sweep | None = Field(None, description="Of method = 'sweep'.")
    sensitivity: Sensitivity | None = Field(None, description="Of method = 'sensitivity'.")
    ablation: Ablation | None = Field(None, description="Of method = 'ablation'.")
    most_jobs: Annotated[int, Field(ge=1, le=1_000_000)] = Field(
        2000, description="Evaluations beyond which the study is refused rather than begun."
    )
    criterion: tuple[StudyCriterion, ...] = Field((), strict=False, description="Claims to judge.")

    @model_validator(mode="before")
    @classmethod
    def _method_table(cls, given: Any) -> Any:
        """The table of the method may be left out."""
        if isinstance(given, dict) and given.get("method") in ("sweep", "sensitivity", "ablation"):
            return {**given, given["method"]: given.get(given["method"], {})}
        return given

    @model_validator(mode="after")
    def _holds_together(self) -> Self:
        for name in ("sweep", "sensitivity", "ablation"):
            if name != self.method and getattr(self, name) is not None:
                raise InputError.of(name, "a table", f"does not go with method = {self.method!r}", "Drop one.")
        for what, names in (
            ("factor", [f.name for f in self.factor]),
            ("factor.path", [f.path for f in self.factor]),
            ("reference", [r.label for r in self.reference]),
            ("output", [o.name for o in self.output]),
            ("criterion", [c.name for c in self.criterion]),
        ):
            twice = next((x for x in names if names.count(x) > 1), None)
            if twice is not None:
                raise InputError.of(what, twice, "appears twice", "Give each its own.")
        labels = [r.label for r in self.reference]
        for output in self.output:
            if output.against is not None and output.against not in labels:
                hint = nearest(output.against, labels) or f"Known: {', '.join(labels) or 'none'}."
                raise InputError.of(f"output {output.name}.against", output.against, "names no reference", hint)
            output.points(self.wavelengths.grid())
        self._known_outputs()
        if not isinstance(self.solver, LedgerSolver) and self.solver.own_seed is not None:
            raise InputError.of(
                "solver.seed", self.solver.own_seed, "an experiment has one seed", "Set `seed` at the top."
            )
        if self.method == "ablation":
            if self.factor:
                raise InputError.of("factor", self.factor[0].name, "does not go with method = 'ablation'", "Drop it.")
            if isinstance(self.solver, LedgerSolver):
                raise InputError.of(
                    "solver.kind", "ledger", "cannot serve an ablation: each case is another scene", "Use 'walk'."
                )
        elif not self.factor:
            raise InputError.of("factor", (), f"method = {self.method!r} needs one that varies", "Add a [[factor]].")
        self._factors_lead_somewhere()
        return self

    def _known_outputs(self) -> None:
        names = [o.name for o in self.output]
        wanted = [(f"criterion[{k}].output", c.output) for k, c in enumerate(self.criterion)]
        if self.ablation is not None:
            wanted += [(f"ablation.target[{k}].output", t.output) for k, t in enumerate(self.ablation.target)]
        for field, name in wanted:
            if name not in names:
                raise InputError.of(
                    field, name, "names no output", nearest(name, names) or f"Known: {', '.join(names)}."
                )
        factors = [f.name for f in self.factor]
        for k, c in enumerate(self.criterion):
            c.check(self.method, f"criterion[{k}]", factors)

    def _factors_lead_somewhere(self) -> None:
        """Both ends of every factor must make a tissue, a reading and an instrument."""
        from livlab.kinds.study.points import Base
        from livlab.kinds.study.room import StudyRoom

        if self.factor:
            StudyRoom(Base(self.tissue.build(), self.reading, self.instrument), self.factor).check_ends()

    def resolve(self) -> Self:
        """With the tissue written out in full."""
        if self.tissue.inline is not None and not self.tissue.set:
            return self
        return self.model_copy(update={"tissue": self.tissue.resolve()})

    def plain(self) -> dict[str, Any]:
        """As TOML's own types; the solver's seed is left out, since it follows from the experiment's."""
        plain = super().plain()
        plain["solver"].pop("seed", None)
        return plain

    def datasets(self) -> tuple[str, ...]:
        """Datasets of the tissue and of the references that are to be had, sorted."""
        from livlab import datasets

        there, missing = set(datasets.names()), datasets.unavailable()
        found = {r.dataset for r in self.reference if r.dataset in there or r.dataset not in missing}
        return tuple(sorted({*self.tissue.build().dataset_names(), *found}))


__all__ = ["StudyExperiment", "StudySolver"]
