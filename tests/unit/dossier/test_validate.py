"""`livlab validate`: what is run, what one failure does to the others, the baseline, and the exit codes."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pytest
from dossier_fakes import CLAIMS, DOSSIER, ended_three, write_dossier, write_run
from typer.testing import CliRunner

from livlab.cli.app import app
from livlab.config import builtin_experiments
from livlab.criteria import Claim
from livlab.dossier.baseline import Baseline, compare, load_baseline, told, undecided, updated, write_baseline
from livlab.dossier.config import builtin_dossier, load_dossier
from livlab.dossier.sure import claims_of, claims_table, family_of, family_record
from livlab.dossier.validate import Ended, Planned, found, planned, validate
from livlab.errors import ConfigError, Interrupted


def test_the_dossier_that_comes_with_livlab_lists_every_experiment_and_answers_every_figure() -> None:
    dossier = load_dossier(builtin_dossier())
    listed = {e.name for g in dossier.group for e in g.experiment}
    assert listed <= set(builtin_experiments())
    names = {a.name for a in dossier.answer}
    figures = ["3.3", "3.4", "4.7", *(f"7.{k}" for k in range(1, 11))]
    assert names == {*(f"Fig. {f}" for f in figures), "Table 6.1", "Table 7.1"}
    experiments = planned(dossier, builtin_dossier())
    assert {e.name for e in experiments} == set(builtin_experiments())
    assert [e.name for e in experiments if e.trouble] == []


def test_what_is_not_listed_is_there_all_the_same_after_the_others(tmp_path: Path) -> None:
    file = write_dossier(tmp_path)
    assert [(e.name, e.group) for e in planned(load_dossier(file), file)] == [
        ("one", "curves"),
        ("two", "more"),
        ("unlisted", "rest"),
    ]


def test_a_listed_file_that_is_gone_or_bad_is_told_and_not_run(tmp_path: Path) -> None:
    file = write_dossier(tmp_path, names=("one", "unlisted"))
    (file.parent.parent / "unlisted.toml").write_text("schema = 1\nkind = 'optics'\nname = 'unlisted'\nwhat = 3\n")
    experiments = planned(load_dossier(file), file)
    ran: list[str] = []

    def run(one: Planned) -> Ended:
        ran.append(one.name)
        return Ended("complete", folder=tmp_path)

    ended = validate(experiments, run, tmp_path / "runs")
    assert ran == ["one"]
    assert ended["two"].state == ended["unlisted"].state == "failed"
    assert "two.toml: no such file" in ended["two"].reason
    assert "what" in ended["unlisted"].reason


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (('[[answer.show]]\nexperiment = "two"', '[[answer.show]]\nexperiment = "three"'), "is in no group"),
        (('id = "more"', 'id = "curves"'), "appears twice"),
        (('id = "more"', 'id = "index"'), "name of another page"),
        (('missing = "No experiment takes photographs."', ""), "must say why"),
        (("deviation", "deviations"), "Did you mean 'deviation'"),
        (('claim = "slope"', 'claim = "slope", table = "table"'), "must name a claim, or a table"),
    ],
)
def test_a_slip_in_the_dossiers_file_is_told(tmp_path: Path, change: tuple[str, str], match: str) -> None:
    assert change[0] in DOSSIER
    with pytest.raises(ConfigError) as caught:
        load_dossier(write_dossier(tmp_path, DOSSIER.replace(*change)))
    assert match in f"{caught.value.message} {caught.value.remedy}"


def test_one_that_fails_does_not_stop_the_others_and_ctrl_c_does(tmp_path: Path) -> None:
    file = write_dossier(tmp_path)
    experiments = planned(load_dossier(file), file)
    said: list[str] = []

    def run(one: Planned) -> Ended:
        if one.name == "one":
            raise ConfigError("It broke.", remedy="Mend it.")
        return Ended("complete", folder=tmp_path, seconds=1.0)

    ended = validate(experiments, run, tmp_path / "runs", expected={"two": 600.0, "unlisted": 60.0}, say=said.append)
    assert [e.state for e in ended.values()] == ["failed", "complete", "complete"]
    assert ended["one"].reason == "It broke. Mend it."
    assert any("about 10 min of 11 min left" in line for line in said)

    def stop(one: Planned) -> Ended:
        raise Interrupted("Stopped.")

    with pytest.raises(Interrupted):
        validate(experiments, stop, tmp_path / "runs")


def test_only_leaves_the_rest_out_and_says_so(tmp_path: Path) -> None:
    file = write_dossier(tmp_path)
    dossier = load_dossier(file)
    experiments = planned(dossier, file, ("two",))
    ended = validate(experiments, lambda one: Ended("complete", folder=tmp_path), tmp_path, only=("two",))
    assert [(e.state, "--only" in e.reason) for e in ended.values()] == [
        ("left out", True),
        ("complete", False),
        ("left out", True),
    ]
    with pytest.raises(ConfigError, match="no such experiment"):
        planned(dossier, file, ("tow",))


def test_a_baseline_tells_what_was_lost_and_what_was_gained(tmp_path: Path) -> None:
    file, _, ended = ended_three(tmp_path)
    unrecorded = load_dossier(file).unrecorded
    place = tmp_path / "baseline.json"
    assert load_baseline(place).file == ""
    write_baseline(place, updated(load_baseline(place), ended, unrecorded, seconds={"one": 12.54}))
    first = load_baseline(place)
    assert first.holds == {"one": ("slope",), "unlisted": ()}  # no clock in it, and nothing of what failed
    assert first.seconds == {"one": 12.5}
    assert compare(first, ended, unrecorded) == ([], [])

    worse = (Claim.of("slope", 3.0, 0.01, 2.0, 0.1), Claim.of("height", 1.0, 0.5, 1.0, 2.0), *CLAIMS[2:])
    ended["one"] = Ended("complete", folder=write_run(tmp_path / "runs" / "again", claims=worse))
    lost, gained = compare(first, ended, unrecorded)
    assert [(c.experiment, c.claim, c.verdict) for c in lost] == [("one", "slope", "FAIL")]
    assert [(c.experiment, c.claim) for c in gained] == [("one", "height")]

    ended["one"] = Ended("complete", folder=write_run(tmp_path / "runs" / "third", claims=CLAIMS[1:]))
    assert [c.why for c in compare(first, ended, unrecorded)[0]] == ["the experiment no longer makes this claim"]
    ended["one"] = Ended("failed", "it broke")
    (change,) = compare(first, ended, unrecorded)[0]
    assert (change.verdict, change.why) == ("MISSING", "its experiment has no result: it broke")
    assert compare(first, ended, unrecorded, only=("two",)) == ([], [])
    assert updated(first, ended, unrecorded)["experiments"]["one"]["holds"] == ["slope"]  # kept: it did not run
    del ended["one"]
    assert compare(first, ended, unrecorded)[0][0].why == "its experiment is gone"


def test_a_claim_that_is_too_close_now_is_told_and_not_lost(tmp_path: Path) -> None:
    file, _, ended = ended_three(tmp_path)
    unrecorded = load_dossier(file).unrecorded
    held = Baseline({"one": ("slope", "height"), "unlisted": ()}, {}, "baseline.json")
    near = (Claim.of("slope", 2.09, 0.01, 2.0, 0.1), Claim.of("height", 9.0, 0.5, 1.0, 2.0))
    ended["one"] = Ended("complete", folder=write_run(tmp_path / "runs" / "near", claims=near))
    lost, gained = compare(held, ended, unrecorded)
    assert [(c.claim, c.verdict) for c in lost] == [("height", "FAIL")]
    assert gained == []
    (close,) = undecided(held, ended, unrecorded)
    assert (close.claim, close.verdict) == ("slope", "TOO CLOSE")
    assert "needs about" in close.why
    assert told(held, lost, gained, [close])["undecided"][0]["claim"] == "slope"
    assert updated(held, ended, unrecorded)["experiments"]["one"]["holds"] == []


def test_the_dossier_states_the_error_of_all_its_claims(tmp_path: Path) -> None:
    _, _, ended = ended_three(tmp_path)
    claims = claims_of(ended)
    found = family_record(family_of(claims))
    assert (found["claims"], found["decided"], found["fails"]) == (2, 2, 1)  # slope and height; seconds are exact
    assert found["at_least_one_wrong_sidak"] == pytest.approx(1 - (1 - 0.02275) ** 2, abs=1e-6)
    assert found["fails_in_doubt"] == []
    assert found["again_seconds_of_fails"] == 8.0
    json.dumps(found, allow_nan=False)
    rows = list(csv.DictReader(io.StringIO(claims_table(claims))))
    assert [r["criterion"] for r in rows] == ["slope", "height", "depth", "seconds thesis"]
    assert rows[1]["again_seconds"] == "8"
    assert float(rows[1]["p_holm"]) < 1e-20
    assert rows[3]["p"] == ""


def test_a_damaged_baseline_is_told(tmp_path: Path) -> None:
    place = tmp_path / "baseline.json"
    for text in ("{", "[]", '{"schema": 2, "experiments": {}}', '{"schema": 1, "experiments": {"one": {}}}'):
        place.write_text(text)
        with pytest.raises(ConfigError):
            load_baseline(place)


def _call(tmp_path: Path, file: Path, *options: str) -> tuple[int, str]:
    given = ["validate", "--dossier", str(file), "--out", str(tmp_path / "site"), "--runs", str(tmp_path / "runs")]
    done = CliRunner().invoke(app, [*given, *options])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return done.exit_code, done.output


def test_the_command_from_nothing_to_a_checked_baseline(tmp_path: Path) -> None:
    """True experiments, the cheapest there are, each in a process of its own."""
    text = DOSSIER.replace('claim = "slope"', 'claim = "absorption of water at 500 nm in 1/cm"')
    file = write_dossier(tmp_path, text)
    claim = '[[criterion]]\nmetric = "value"\nof = "water"\nwavelength_nm = 500.0\nreference = {r}\ntolerance = 0.001\n'
    one = file.parent.parent / "one.toml"
    bare = one.read_text()
    one.write_text(bare + claim.format(r=0.00025))
    (file.parent.parent / "two.toml").write_text(bare.replace('"one"', '"two"').replace("water_segel", "nothing_"))
    code, said = _call(tmp_path, file, "--update-baseline")
    assert code == 0
    assert "MISSING two: " in said
    assert "1 PASS, 0 FAIL, 0 MISSING" in said
    held = json.loads(file.with_name("baseline.json").read_text())["experiments"]
    assert held["one"]["holds"] == ["absorption of water at 500 nm in 1/cm"]
    assert held["one"]["seconds"] > 0

    code, said = _call(tmp_path, file, "--check", "--only", "one")
    assert code == 0
    assert "done before" in said

    one.write_text(bare + claim.format(r=0.5))
    code, said = _call(tmp_path, file, "--check", "--only", "one", "--quiet")
    assert code == 1
    assert "HELD BEFORE, NOW FAIL: one: absorption of water at 500 nm in 1/cm" in said
    record = json.loads((tmp_path / "site" / "validation.json").read_text())
    assert record["baseline"]["lost"][0]["experiment"] == "one"
    assert [e["state"] for e in record["experiments"]] == ["complete", "failed", "complete"]


def test_check_without_a_baseline_is_refused(tmp_path: Path) -> None:
    given = ["validate", "--dossier", str(write_dossier(tmp_path)), "--check"]
    assert isinstance(CliRunner().invoke(app, given).exception, ConfigError)


def test_a_process_that_dies_or_breaks_is_a_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from livlab.cli import apart

    file = write_dossier(tmp_path)
    one = planned(load_dossier(file), file)[0]
    (tmp_path / "runs").write_text("a file where a folder is needed")
    told = apart.runner(tmp_path / "runs", quiet=True)
    ended = told(one)
    assert ended.state == "failed"
    assert "runs" in ended.reason
    assert found(one.config, tmp_path / "elsewhere") is None  # type: ignore[arg-type]
    assert apart._died(-9) == "its process was ended by SIGKILL (out of memory?)"
    assert apart._died(3) == "its process ended with status 3 and said nothing"
