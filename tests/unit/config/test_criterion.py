"""What a criterion of an experiment file may say of its limits, in every kind that has criteria."""

from typing import Any

import pytest

from livlab.config.load import builtin_experiments, load_experiment
from livlab.errors import InputError
from livlab.kinds.brdf.config import BrdfCriterion
from livlab.kinds.fit.config import FitCriterion
from livlab.kinds.optics.config import OpticsCriterion
from livlab.kinds.picture.config import PictureCriterion
from livlab.kinds.spectral.config import CriterionSpec
from livlab.kinds.study.config_parts import Output, StudyCriterion

KINDS: list[tuple[Any, dict[str, Any]]] = [
    (CriterionSpec, {"metric": "rmse", "against": "human liver"}),
    (FitCriterion, {"metric": "rmse", "of": "human liver"}),
    (OpticsCriterion, {"metric": "rmse", "of": "in air", "radius_um": 0.05}),
    (BrdfCriterion, {"metric": "rmse", "against": "nunes2017"}),
    (StudyCriterion, {"output": "RMSE", "statistic": "least"}),
]
OUTPUTS = [Output(metric="rmse", label="RMSE", against="human liver")]


def aim(spec: Any) -> Any:
    return spec.aim(OUTPUTS) if isinstance(spec, StudyCriterion) else spec.aim


@pytest.mark.parametrize(("kind", "about"), KINDS)
def test_one_form_or_the_other(kind: Any, about: dict[str, Any]) -> None:
    assert aim(kind(**about, reference=0.0, tolerance=0.1)).text == "at most 0.1"
    assert aim(kind(**about, at_most=0.23)).text == "at most 0.23"
    assert aim(kind(**about, at_least=0.1, at_most=0.23)).text == "0.1 to 0.23"
    assert aim(kind(**about, reference=0.19, tolerance=0.04, group="agrees")).text == "at most 0.23"
    assert aim(kind(**about, reference=0.19, tolerance=0.04, group="reproduces")).text == "0.19 ± 0.04"
    for wrong in ({}, {"reference": 0.0}, {"reference": 0.0, "tolerance": 0.1, "at_most": 0.2}):
        with pytest.raises((InputError, ValueError), match="needs reference and tolerance"):
            kind(**about, **wrong)
    with pytest.raises((InputError, ValueError), match="group"):
        kind(**about, at_most=0.2, group="thesis")


def test_a_brdfs_tolerance_alone_is_about_zero_and_a_check_of_livlab() -> None:
    own = BrdfCriterion(metric="rmse", against="fit", tolerance=0.02)
    assert (own.reference, own.aim.group, own.aim.text) == (0.0, "checks", "at most 0.02")
    assert BrdfCriterion(metric="mse", against="nunes2017", tolerance=1e-4).aim.group == "agrees"


def test_a_pictures_limits() -> None:
    assert PictureCriterion(metric="chroma", within=(0.0, 8.0)).aim.text == "at most 8"
    assert PictureCriterion(metric="hue", within=(15.0, 60.0)).aim.text == "15 to 60"
    assert PictureCriterion(metric="speed", at_least=4.4e6).aim.text == "at least 4.4e+06"
    assert PictureCriterion(metric="hue", at_most=60.0).aim.group == "checks"
    for wrong in ({}, {"within": (0.0, 1.0), "at_most": 1.0}, {"at_least": 2.0, "at_most": 1.0}):
        with pytest.raises((InputError, ValueError), match=r"limit|at_least"):
            PictureCriterion(metric="hue", **wrong)


def test_the_experiments_that_come_with_livlab_are_grouped() -> None:
    """By name, once: what the thesis prints, and what was measured of an organ; all else checks livlab itself."""
    found: dict[str, set[str]] = {}
    for name, path in builtin_experiments().items():
        config = load_experiment(path)
        for c in getattr(config, "criterion", ()):
            group = c.aim(config.output).group if isinstance(c, StudyCriterion) else c.aim.group  # type: ignore[attr-defined]
            found.setdefault(group, set()).add(name)
    assert found["reproduces"] == {"spectral", "readings"}
    assert found["agrees"] == {
        "spectral", "spectral-camera", "spectral-skin", "fit-liver", "fit-two-livers", "sweep-liver", "brdf-liver-45",
        "brdf-liver-collinear",
    }  # fmt: skip
