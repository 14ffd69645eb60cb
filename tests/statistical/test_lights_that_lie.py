"""Rigs that lie about their lights are told, honest ones are not: a matrix of cases and draws of noise."""

from __future__ import annotations

import re

import pytest
from light_rigs import HONEST, LIARS, photographed

from livlab.acquire.photographs.light_table import light_table

DRAWS = 20


def said(case, draw):
    return " ".join(light_table(photographed(case, draw)).warnings)


@pytest.mark.parametrize("name", LIARS)
def test_a_liar_is_told_with_what_it_did(name):
    told = said(LIARS[name], 0)
    assert re.search(LIARS[name].sees, told), told


@pytest.mark.parametrize("name", HONEST)
def test_an_honest_rig_is_not_doubted(name):
    assert said(HONEST[name], 1) == ""


@pytest.mark.slow
@pytest.mark.parametrize("name", LIARS)
def test_liars_are_told_in_nine_of_ten_draws(name, capsys):
    case = LIARS[name]
    found = [said(case, draw) for draw in range(DRAWS)]
    told, named = sum(map(bool, found)), sum(bool(re.search(case.sees, text)) for text in found)
    with capsys.disabled():
        print(f"\n| {name} | {told} | {named} |")
    assert min(told, named) >= 0.9 * DRAWS, found


@pytest.mark.slow
@pytest.mark.parametrize("name", HONEST)
def test_honest_rigs_are_doubted_in_one_of_twenty_draws_at_most(name, capsys):
    found = [said(HONEST[name], draw) for draw in range(DRAWS)]
    with capsys.disabled():
        print(f"\n| {name} | {sum(map(bool, found))} |")
    assert sum(map(bool, found)) <= 0.05 * DRAWS, [text for text in found if text]
