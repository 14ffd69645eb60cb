"""Any experiment, written out in full and read back, is the same experiment with the same digest."""

from __future__ import annotations

from typing import Any

import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from livlab.config import parse_experiment, to_toml
from livlab.runs.identity import canonical, digest

SHARE = st.floats(0.0, 1.0)
TEXT = st.text(st.characters(exclude_categories=("Cs", "Cc"), include_characters="\n\t"), max_size=40)

NAMES = st.lists(st.sampled_from(["thesis", "consistent", "measured"]), min_size=1, unique=True)
OWN = st.fixed_dictionaries(
    {"base": st.sampled_from(["thesis", "consistent", "measured"]), "name": st.sampled_from(["mine", "a ‘b’", "x, y"])},
    optional={
        "redirect_factor": st.sampled_from(["cos", "none", "abs_cos"]),
        "elastin_refractive_index": st.sampled_from([1.5, 1.534]),
    },
)
WAVELENGTHS = st.one_of(
    st.builds(
        lambda a, n, d: {"start_nm": a, "stop_nm": a + n * d, "step_nm": d},
        st.integers(450, 700), st.integers(1, 40), st.integers(1, 20),
    ),
    st.builds(lambda x: {"list_nm": sorted(x)}, st.sets(st.integers(450, 700), min_size=1, max_size=9)),
)  # fmt: skip
INSTRUMENT = st.one_of(
    st.fixed_dictionaries({"kind": st.just("collinear")}, optional={"acceptance_deg": st.floats(1, 90)}),
    st.fixed_dictionaries({"kind": st.just("collinear")}, optional={"sample_side_mm": st.just("infinite")}),
    st.fixed_dictionaries({"kind": st.just("fibre-probe")}, optional={"distance_mm": st.floats(0.5, 100)}),
    st.fixed_dictionaries(
        {"kind": st.just("hyperspectral-camera")}, optional={"polarisation": st.sampled_from(["none", "crossed"])}
    ),
)
SOLVER = st.one_of(
    st.just({"kind": "adding-doubling", "tolerance": 1e-4}),
    st.builds(lambda n: {"kind": "walk", "samples": n}, st.integers(1000, 10**9)),
    st.builds(lambda x: {"kind": "walk", "relative": x}, st.floats(1e-4, 0.5)),
    st.just({"kind": "walk", "estimator": "analog", "max_seconds": 3.5}),
)
TISSUE = st.fixed_dictionaries(
    {"state": st.sampled_from(["ex_vivo", "in_vivo", "steatosis"])},
    optional={
        "variant": st.sampled_from(["whole", "parenchyma_only"]),
        "set": st.dictionaries(
            st.sampled_from(
                [
                    "layers.parenchyma.elements.blood.oxygenation",
                    "layers.parenchyma.elements.bile.fraction",
                    "layers.parenchyma.elements.hepatocyte.albedo",
                ]
            ),
            st.floats(0.0, 0.04),
            max_size=3,
        ),
    },
)
CRITERION = st.fixed_dictionaries(
    {
        "metric": st.sampled_from(["pearson", "rmse"]),
        "against": st.just("liver"),
        "reference": SHARE,
        "tolerance": SHARE,
    },
    optional={"on": st.sampled_from(["points", "curve"])},
)


@st.composite
def experiments(draw: st.DrawFn) -> dict[str, Any]:
    return {
        "schema": 1, "name": draw(st.from_regex(r"[a-zA-Z0-9][\w-]{0,20}", fullmatch=True).filter(str.isascii)),
        "title": draw(TEXT), "description": draw(TEXT), "seed": draw(st.integers(0, 2**31 - 1)),
        "readings": draw(NAMES), "tissue": draw(TISSUE), "wavelengths": draw(WAVELENGTHS),
        "instrument": draw(INSTRUMENT), "solver": draw(SOLVER),
        "processing": {"interpolate_nm": 1.0, "moving_average": 1, "normalise": draw(st.sampled_from(["max", "sum"]))},
        "reading": draw(st.lists(OWN, max_size=2, unique_by=lambda x: x["name"])),
        "reference": [{"label": "liver", "dataset": "liver_hsi_sellner2026", "column": "human_reflectance_share"}],
        "criterion": draw(st.lists(CRITERION, max_size=1)),
    }  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(experiments())
def test_written_out_in_full_and_read_back_it_is_the_same(data: dict[str, Any]) -> None:
    given_file = parse_experiment(tomli_w.dumps(data))
    full = given_file.resolve()
    back = parse_experiment(to_toml(full))
    assert back.resolve() == full
    assert full.resolve() == full
    assert canonical(back) == canonical(given_file)
    assert parse_experiment(to_toml(given_file)) == given_file
    assert to_toml(back.resolve()) == to_toml(full)


@settings(max_examples=30, deadline=None)
@given(experiments(), experiments())
def test_two_experiments_have_one_digest_only_if_they_are_one(a: dict[str, Any], b: dict[str, Any]) -> None:
    first, second = parse_experiment(tomli_w.dumps(a)), parse_experiment(tomli_w.dumps(b))
    assert (digest(first, {}) == digest(second, {})) == (first.resolve() == second.resolve())
