"""`[accuracy]` in an experiment file: what it implies, what it refuses, and that it survives being written out."""

import pytest

from livlab.acquire.instruments.solvers import AutoSolver, WalkSolver
from livlab.config import parse_experiment, to_toml
from livlab.errors import ConfigError
from livlab.model.transport.accuracy import Accuracy

BASE = """\
schema = 1
name = "small"
readings = ["consistent"]
wavelengths = { list_nm = [500, 600] }
instrument = { kind = "collinear" }
"""


def test_a_wish_implies_the_solver_that_meets_it():
    found = parse_experiment(BASE + "accuracy = { seconds = 10 }")
    assert found.solver == AutoSolver()
    assert found.accuracy == Accuracy(seconds=10.0)


def test_the_solver_without_a_wish_has_the_default_one_written_out():
    found = parse_experiment(BASE + 'solver = { kind = "auto" }')
    assert found.accuracy == Accuracy(relative=0.002)
    assert "relative = 0.002" in to_toml(found)


def test_without_either_nothing_changes():
    found = parse_experiment(BASE)
    assert isinstance(found.solver, WalkSolver)
    assert found.accuracy is None
    assert "accuracy" not in to_toml(found)


@pytest.mark.parametrize("wish", ["relative = 0.01", "standard_error = 0.002", "seconds = 3.5"])
def test_a_wish_survives_being_written_and_read(wish):
    found = parse_experiment(BASE + f"accuracy = {{ {wish} }}")
    again = parse_experiment(to_toml(found.resolve()))
    assert again == found.resolve()
    assert again.accuracy == found.accuracy


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("accuracy = { relative = 0.01, seconds = 3 }", "exactly one"),
        ("accuracy = {}", "exactly one"),
        ("accuracy = { relativ = 0.01 }", "accuracy.relativ .*unknown key. Did you mean 'relative'"),
        ("accuracy = { seconds = -1 }", "accuracy.seconds = -1: must be greater than 0"),
        (
            'accuracy = { relative = 0.01 }\nsolver = { kind = "walk" }',
            r"solver.kind = 'walk': .*accuracy",
        ),
        ('solver = { kind = "auto", seed = 3 }', "one seed"),
    ],
)
def test_what_cannot_be_is_refused(text, said):
    with pytest.raises(ConfigError, match=said):
        parse_experiment(BASE + text)
