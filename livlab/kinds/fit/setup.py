"""What a fit is set up from, whoever asks for it: targets, forward models of each tissue measured, and the search."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from livlab.errors import InputError, RangeError
from livlab.fitting.fit import fit
from livlab.fitting.forward import LedgerForward, Response
from livlab.fitting.idle import idle_parameters
from livlab.fitting.options import FitOptions
from livlab.fitting.outcome import FitOutcome
from livlab.fitting.problem import Problem
from livlab.fitting.scenes import JointForward
from livlab.fitting.targets import CurveTarget
from livlab.kinds.fit import tables
from livlab.kinds.fit.config import FitExperiment, Measurement, Scene
from livlab.model.tissue.limits import limits_of
from livlab.model.tissue.tissue import Tissue, override
from livlab.optimise import ParameterSpace
from livlab.units import FloatArray

if TYPE_CHECKING:
    from livlab.kinds.shared.references import Known


STARTS = 4
"""Searches that begin where some of the box is no tissue."""


@dataclass(frozen=True, eq=False)
class MeasuredCurve:
    """A measured curve on the fit's wavelengths.

    Attributes
    ----------
    data, sd
        (W,) the curve and its standard deviation over subjects (None: not known); nan outside its range.
    measured_nm
        (N,) rising wavelengths at which it was measured; what lies between is interpolated.
    """

    data: FloatArray
    sd: FloatArray | None
    measured_nm: FloatArray

    @property
    def range_nm(self) -> tuple[float, float]:
        """First and last wavelength that it has."""
        return float(self.measured_nm[0]), float(self.measured_nm[-1])

    @classmethod
    def known(cls, reference: Known, grid: FloatArray) -> Self:
        """A dataset's curve on the grid."""
        assert reference.dataset is not None
        return cls(*reference.at(grid), reference.dataset.wavelength_nm)

    def own(self, use: NDArray[np.bool_], grid: FloatArray) -> NDArray[np.bool_]:
        """`use` without what is only interpolated: where the grid is finer than the measurement, the nearest points.

        N measured numbers that are compared at M > N wavelengths would count as M, and intervals would be too narrow by
        about √(M/N).

        >>> curve = MeasuredCurve(np.arange(5.0), None, np.array([500.0, 540.0]))
        >>> curve.own(np.full(5, True), np.linspace(500.0, 540.0, 5)).tolist()
        [True, False, False, False, True]
        """
        at = grid[use]
        if at.size < 2:
            return use
        half = 0.5 * float(np.diff(at).min())
        own = self.measured_nm[(self.measured_nm >= at[0] - half) & (self.measured_nm <= at[-1] + half)]
        if own.size >= at.size:
            return use
        nearest = np.abs(at[:, None] - own).argmin(axis=0)
        kept = np.zeros_like(use)
        kept[np.flatnonzero(use)[nearest]] = True
        return kept


@dataclass(frozen=True, eq=False)
class FitSetup:
    """A fit before any light is followed.

    Attributes
    ----------
    config
        What is asked.
    space, forward
        The parameters, and the model: the curves of all tissues that were measured, end to end.
    targets
        What is to be had of the measurements, by label.
    notes
        What was left out of a measurement, and why; what of the box is no tissue.
    walled
        Whether some of the box is none: a search that meets such a wall stops there, so several begin.
    """

    config: FitExperiment
    space: ParameterSpace
    forward: JointForward
    targets: dict[str, CurveTarget]
    notes: tuple[str, ...] = ()
    walled: bool = False

    @classmethod
    def of(cls, config: FitExperiment, curves: Mapping[str, MeasuredCurve]) -> Self:
        """Everything that can go wrong before light is followed: bands, the tissue at the start and at the bounds.

        Raises
        ------
        InputError
            A curve without enough points on the wavelengths, or a bound that no tissue reaches.
        RangeError, DatasetError
            A dataset of the tissue that is damaged, or does not reach.
        """
        scenes, grid = config.scenes(), config.wavelengths.grid()
        measured = [m for m in config.measurement if m.label in curves]
        targets = {m.label: target(m, curves[m.label], grid, scene_of(scenes, m.label), len(scenes)) for m in measured}
        notes = [_thinned(targets[m.label], curves[m.label], m, grid) for m in measured]
        space = ParameterSpace(config.parameters())
        walls = config.room().check()
        forward = JointForward([_forward(config, scene) for scene in scenes], [scene.keys for scene in scenes])
        forward.stack(space.values(space.vector({})))
        return cls(config, space, forward, targets, tuple(filter(None, [*notes, walls])), bool(walls))

    @property
    def fitted(self) -> list[CurveTarget]:
        """The targets that the fit sees."""
        return [self.targets[m.label] for m in self.config.measurement if m.role == "fit" and m.label in self.targets]

    @property
    def algorithm(self) -> str | tuple[str, ...]:
        """As `livlab.fitting.options.FitOptions` has it."""
        asked = self.config.search.algorithm
        return "auto" if asked == ("auto",) else asked

    def search(
        self,
        *,
        progress: Callable[[str, float], None] | None = None,
        stopping: Callable[[], bool] | None = None,
    ) -> FitOutcome:
        """`livlab.fitting.fit.fit` as the experiment asks for it."""
        how = self.config.search
        options = FitOptions(
            algorithm=self.algorithm,
            starts=max(how.starts, STARTS) if self.walled else how.starts,
            seed=self.config.seed,
            max_evaluations=how.max_evaluations,
            max_seconds=how.max_seconds,
            most_recordings=how.most_recordings,
            level=self.config.level,
        )
        problem = Problem(self.forward, self.fitted, self.space)
        found = fit(problem, options, progress=progress, stopping=stopping)
        return replace(found, notes=(*found.notes, *self._idle(idle_parameters(problem, found))))

    def _idle(self, sizes: Mapping[str, float]) -> list[str]:
        """What to say of parameters that move nothing, and why that may be."""
        made, tissue = [], self.config.tissue.build()
        for p in self.config.parameter:
            if p.key in sizes:
                words = limits_of(tissue, p.path, self.config.reading)
                made.append(
                    f"{p.name} moves the curve by less than its error over its whole range, {p.low:g} to {p.high:g} "
                    f"(by {sizes[p.key]:.2g} standard deviations of all data together): its value means nothing. "
                    f"{' '.join(words)}".rstrip()
                )
        return made

    def curves(self, found: FitOutcome) -> tuple[Response, FloatArray]:
        """The model at the optimum, and at the start, nan where the last walk cannot answer for the start."""
        first = self.forward.answer(found.space.values(found.space.vector({})))
        return self.forward.answer(found.best), np.where(first.valid, first.value, np.nan)

    def said(self, found: FitOutcome) -> list[str]:
        """What a report must show, by the parameters' labels, once each."""
        edge = self.config.room().ends_at(found.best)
        stack = self.forward.stack(found.best)
        texts = (*self.notes, *edge, found.misfit_words, *stack.notes, *found.notes, *found.verdict.sentences)
        return list(dict.fromkeys(tables.named(text, self.config) for text in texts))

    def tissue(self, label: str, best: Mapping[str, float]) -> Tissue:
        """The tissue that a measurement saw, at these values of the parameters."""
        scenes = self.config.scenes()
        scene = scenes[scene_of(scenes, label)]
        values = {**scene.set, **{path: best[key] for path, key in scene.keys.items()}}
        return override(self.config.tissue.build(), values, by="fit")


def scene_of(scenes: list[Scene], label: str) -> int:
    """Number of the scene that a measurement saw."""
    return next(i for i, scene in enumerate(scenes) if label in scene.labels)


def _forward(config: FitExperiment, scene: Scene) -> LedgerForward:
    tissue = config.tissue.build()
    return LedgerForward(
        override(tissue, scene.set, by="measurement") if scene.set else tissue,
        config.reading,
        config.wavelengths.grid(),
        config.instrument,
        list(scene.keys),
        standard_error=config.search.standard_error,
        variant=config.variant,
    )


def target(m: Measurement, curve: MeasuredCurve, grid: FloatArray, place: int, scenes: int) -> CurveTarget:
    """A measurement on the wavelengths of its own scene; the other scenes' places are not used.

    Raises
    ------
    InputError
        A curve shorter than its band, or that cannot be compared.
    """
    data = curve.data
    if m.sd_column is not None and curve.sd is not None:
        sigma = curve.sd / np.sqrt(m.subjects)
    elif m.sd is not None:
        sigma = np.full_like(data, m.sd)
    elif m.relative_sd is not None:
        sigma = m.relative_sd * np.abs(data)
    else:
        sigma = np.full_like(data, np.nan)
    use = np.isfinite(data)
    if m.band_nm is not None:
        band = (grid >= m.band_nm[0]) & (grid <= m.band_nm[1])
        if not use[band].all():
            low, high = curve.range_nm
            had = (max(low, m.band_nm[0]), min(high, m.band_nm[1]))
            remedy = f"Use band_nm = [{had[0]:g}, {had[1]:g}]." if had[0] < had[1] else "Use a curve of that band."
            raise InputError.of(
                f"measurement {m.label}.band_nm", m.band_nm, f"reaches beyond the curve, {low:g}–{high:g} nm", remedy
            )
        use &= band
    if m.loss != "colour":  # three numbers, which need every wavelength between
        use = curve.own(use, grid)
    colour = colour_of(m, grid[use])

    def placed(values: Any, empty: Any) -> Any:
        made = np.full((scenes, len(grid)), empty)
        made[place] = values
        return made.ravel()

    return CurveTarget(
        m.label,
        placed(use, False),
        placed(data, np.nan),
        placed(sigma, np.nan),
        scaling=m.scaling,
        loss=m.loss,
        weight=m.weight,
        colour=colour,
        wavelength_nm=placed(grid, np.nan),
    )


def _thinned(made: CurveTarget, curve: MeasuredCurve, m: Measurement, grid: FloatArray) -> str:
    """What to say of a curve with fewer points than the wavelengths compared; nothing for others."""
    low, high = m.band_nm or (-np.inf, np.inf)
    there = int((np.isfinite(curve.data) & (grid >= low) & (grid <= high)).sum())
    if m.loss == "colour" or made.size == there:
        return ""
    return (
        f"{m.label} was measured at fewer wavelengths than the fit has: {made.size} of {there} are compared, the "
        "nearest to the measured ones, since what lies between is interpolated and tells nothing more."
    )


def _doubt(made: CurveTarget, m: Measurement, grid: FloatArray) -> str:
    """What a colour loss cannot know of the measured colour; nothing for other losses."""
    if m.loss != "colour":
        return ""
    from livlab.model.colour import daylight_doubt

    told = daylight_doubt(np.tile(grid, made.use.size // len(grid))[made.use], made.data[made.use])
    return told and f"{m.label}: {told}"


def colour_of(m: Measurement, wavelength_nm: FloatArray) -> Callable[[FloatArray], FloatArray] | None:
    """The colour of a curve, where the loss is one.

    Raises
    ------
    InputError
        Wavelengths that tell no colour.
    """
    if m.loss != "colour":
        return None
    from livlab.model.colour import daylight_lab

    try:
        return daylight_lab(wavelength_nm)
    except (RangeError, InputError) as error:
        band = f"{wavelength_nm[0]:g}–{wavelength_nm[-1]:g} nm" if len(wavelength_nm) else "no wavelength"
        raise InputError.of(
            f"measurement {m.label}.loss",
            "colour",
            f"needs a band that holds what the eye sees, and {band} are compared: {error.message.rstrip('.')}",
            "Compare 400–700 nm or more with steps of 10 nm or less (wavelengths, band_nm, and what the dataset has), "
            "or use another loss.",
        ) from None


__all__ = ["FitSetup", "MeasuredCurve", "colour_of", "scene_of", "target"]
