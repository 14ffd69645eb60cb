"""Each element gives what its file says it must, and one that leaves something out is refused when it is made."""

import re
from typing import Any, ClassVar, Literal

import numpy as np
import pytest
from pydantic import Field

from livlab.model.tissue.elements import ELEMENTS
from livlab.model.tissue.elements.base import Absorber, Amount, ElementBase, Omission, Remarks, Scatterer, Share
from livlab.model.tissue.elements.cell import Cell
from livlab.model.tissue.elements.law_absorber import LawAbsorber
from livlab.model.tissue.elements.mixture import Mixture
from livlab.model.tissue.elements.solute import Solute
from livlab.model.tissue.readings import READINGS, reading
from livlab.model.tissue.setting import Setting

KINDS = {cls.model_fields["kind"].annotation.__args__[0]: cls for cls in ELEMENTS}
REFERENCES = [
    pytest.param(cls, value, id=f"{kind}-{number}")
    for kind, cls in KINDS.items()
    for number, value in enumerate(cls.reference_values())
]


def made(cls: type[ElementBase], value: Any) -> ElementBase:
    kind = cls.model_fields["kind"].annotation.__args__[0]
    return cls.model_validate({"kind": kind, **value.element})


def setting(value: Any) -> Setting:
    name, options = value.reading
    one = np.ones(2)
    return Setting(value.wavelength_nm * one, value.n_medium * one, reading(name, **options))


@pytest.mark.parametrize(("cls", "value"), REFERENCES)
def test_an_element_gives_its_reference_values(cls: type[ElementBase], value: Any) -> None:
    found = made(cls, value).interaction("it", setting(value))
    np.testing.assert_allclose(found.rate, value.rate, rtol=value.relative, err_msg=value.source)
    np.testing.assert_allclose(found.albedo, value.albedo, rtol=1e-12)
    if value.anisotropy is not None:
        g = [p.anisotropy for p in found.phases]
        np.testing.assert_allclose(g, value.anisotropy, rtol=value.relative, atol=1e-12, err_msg=value.source)


@pytest.mark.parametrize("cls", ELEMENTS)
def test_every_element_has_reference_values_and_says_what_its_fields_are(cls: type[ElementBase]) -> None:
    assert cls.reference_values()
    for row in cls.parameters():
        assert row.meaning.endswith(".")
        assert bool(row.unit) == row.is_number


@pytest.mark.parametrize(("cls", "value"), REFERENCES)
def test_what_a_bench_moves_is_what_the_element_absorbs(cls: type[ElementBase], value: Any) -> None:
    element = made(cls, value)
    found = element.movable_absorption("the_element", setting(value))
    if found is None:
        assert not issubclass(cls, Absorber)
        return
    np.testing.assert_allclose(found.now, value.rate, rtol=1e-9)
    keys = {row.key for row in cls.parameters()}
    for slider in found.sliders:
        assert re.sub(r"^parts\.\w+\.", "parts.NAME.", slider.key) in keys
        assert slider.low < slider.high
        assert "_" not in slider.label


def test_parameters_have_unit_bounds_and_default() -> None:
    rows = {row.key: row for row in KINDS["blood"].parameters()}
    assert (rows["oxygenation"].unit, rows["oxygenation"].bounds, rows["oxygenation"].required) == ("1", "[0, 1]", True)
    assert (rows["haemoglobin_g_per_l"].unit, rows["haemoglobin_g_per_l"].default) == ("g/L", 150.0)
    assert rows["vessel_radius_um"].bounds == "[0, ∞)"
    fibre = {row.key: row for row in KINDS["fibre"].parameters()}
    assert (fibre["index"].bounds, fibre["diameter_um"].bounds) == ("(0.1, 10)", "(0, ∞)")
    assert (fibre["law"].choices, fibre["law"].bounds) == (("mie", "rayleigh"), "mie, rayleigh")
    law = {row.key: row for row in LawAbsorber.parameters()}
    assert (law["decay_nm"].bounds, law["decay_nm"].required, law["exponent"].bounds) == ("(0, ∞)", False, "")
    assert {row.key for row in Mixture.parameters()} == {"fraction", "parts.NAME.share", "parts.NAME.spectrum"}


def test_a_penalised_rate_and_its_remark_come_together() -> None:
    cell = Cell(kind="cell", fraction=0.1, a_um=20.0, b_um=20.0, anisotropy=0.8)
    assert cell.remarks(READINGS["thesis"]).walk
    assert not cell.remarks(READINGS["consistent"]).walk
    assert cell.remarks(READINGS["consistent"]).derived[0].value == pytest.approx(75.0)


class Complete:
    """All that a toy absorber must say."""

    def absorption(self, setting: Setting) -> Any:
        return 0.1 * np.ones_like(setting.wavelength_nm)

    def dataset_names(self) -> tuple[str, ...]:
        return ()

    def omissions(self) -> tuple[Omission, ...]:
        return ()

    def movable_absorption(self, name: str, setting: Setting) -> None:
        return None

    @classmethod
    def reference_values(cls) -> tuple[Any, ...]:
        return ()


def toy(leave_out: str = "", base: type[ElementBase] = Absorber, **own: Any) -> type[ElementBase]:
    methods = {k: v for k, v in vars(Complete).items() if not k.startswith("__") and k != leave_out}
    annotations = {"kind": Literal["toy"], **own.pop("annotations", {})}
    return type("Toy", (base,), {"__module__": __name__, "__annotations__": annotations, **methods, **own})


@pytest.mark.parametrize(
    "method", ["absorption", "dataset_names", "omissions", "movable_absorption", "reference_values"]
)
def test_an_element_without_a_method_is_no_class(method: str) -> None:
    assert toy()(kind="toy").interaction("it", Setting(np.ones(1), np.ones(1), READINGS["consistent"])).rate == 0.1
    with pytest.raises(TypeError, match=f"element Toy lacks {method}: "):
        toy(leave_out=method)


def test_a_scatterer_must_say_what_the_readings_make_of_it() -> None:
    with pytest.raises(TypeError, match="element Toy lacks interaction: The element as the walk meets it"):
        toy(base=Scatterer)


def test_numbers_need_units_and_budgets_a_share() -> None:
    share = {"annotations": {"fraction": Share, "budget": ClassVar[str]}, "fraction": Field(description="Fraction.")}
    with pytest.raises(TypeError, match="element Toy lacks a unit of fraction"):
        toy(**share)
    annotated = {"annotations": {"budget": ClassVar[str]}, "budget": "composition"}
    with pytest.raises(TypeError, match="element Toy lacks share: its budget 'composition' counts it"):
        toy(**annotated)
    amount = {"annotations": {"amount": Amount | None}, "amount": Field(None, description="Amount.")}
    with pytest.raises(TypeError, match="lacks a unit of amount"):
        toy(**amount)


def test_what_an_absorber_has_nothing_to_say_of() -> None:
    element = Solute.model_validate({"kind": "solute", **Solute.reference_values()[0].element})
    assert element.subjects() == ()
    assert element.remarks(READINGS["thesis"]) == Remarks()
    assert element.movable_scattering() is None
    assert element.stands_in_for == ""
    assert element.settled() is element
