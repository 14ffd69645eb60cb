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
def test_matrix_of_liars_and_honest_rigs(capsys):
    """Each liar told in 90 % of 20 draws at least, by its name in as many; honest rigs falsely in 5 % at most."""
    lines = ["| rig | told | by its name |", "|---|---|---|"]
    low, rates = [], []
    for name, case in LIARS.items():
        found = [said(case, draw) for draw in range(DRAWS)]
        told = sum(bool(text) for text in found)
        named = sum(bool(re.search(case.sees, text)) for text in found)
        lines.append(f"| {name} | {told} of {DRAWS} | {named} |")
        if min(told, named) < 0.9 * DRAWS:
            low.append(name)
    lines += ["", "| honest rig | falsely told |", "|---|---|"]
    for name, case in HONEST.items():
        found = [said(case, draw) for draw in range(DRAWS)]
        rates.append(sum(bool(text) for text in found))
        lines.append(f"| {name} | {rates[-1]} of {DRAWS} |")
        if rates[-1]:
            lines.append(next(text for text in found if text))
    with capsys.disabled():
        print("\n" + "\n".join(lines))
    assert not low
    assert sum(rates) <= 0.05 * DRAWS * len(rates)
