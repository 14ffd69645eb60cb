from pathlib import Path

import architecture_rules as rules
import house
import pytest

ROOT = Path(__file__).resolve().parents[2]


def test_imports_run_downwards_and_engines_have_one_door():
    assert len(house.modules(ROOT)) > 300
    assert rules.import_violations(ROOT) == []


def test_every_room_has_a_floor_and_the_top_is_tidy():
    assert rules.plan_violations(ROOT) == []


def test_nothing_imports_itself_by_way_of_others():
    assert house.all_circles(ROOT) == []


def test_the_picture_of_the_house_is_of_this_house():
    told = "run `python scripts/house.py` and commit docs/images/house.svg"
    assert (ROOT / house.PICTURE).read_text(encoding="utf-8") == house.picture(ROOT), told


def test_no_public_class_has_a_name_that_is_taken():
    assert rules.names_twice(ROOT) == []


def test_instruments_and_elements_are_told_by_what_they_do():
    assert rules.kind_questions(ROOT) == []


def test_functions_and_records_have_their_seams():
    assert rules.long_functions(ROOT) == []
    assert rules.long_records(ROOT) == []


def test_no_data_is_run_as_code():
    assert rules.code_from_data_violations(ROOT) == []


def test_no_module_is_too_long():
    assert rules.long_modules(ROOT) == []


@pytest.mark.parametrize("statement", ["import livlab", "import livlab.cli"])
def test_importing_is_light(statement):
    assert rules.heavy_imports(statement) == []


def test_files_name_no_machine_and_no_registry():
    files = rules.repository_files(ROOT)
    assert ROOT / "pyproject.toml" in files
    assert rules.address_violations(ROOT, files) == []


def test_every_test_can_fail():
    files = sorted((ROOT / "tests").rglob("test_*.py"))
    assert Path(__file__).resolve() in files
    assert rules.assertless_tests(files) == []


def test_constraints_pin_exactly_and_cover_what_is_required():
    import re
    import tomllib

    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    entries = [line for line in lines if line.strip() and not line.startswith("#")]
    assert [line for line in entries if not re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9.+!]+", line)] == []
    pinned = {re.sub(r"[._-]+", "-", line.partition("==")[0]).lower() for line in entries}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [*project["dependencies"], *project["optional-dependencies"]["dev"]]
    names = {re.sub(r"[._-]+", "-", re.split(r"[\s<>=!~;\[]", entry, maxsplit=1)[0]).lower() for entry in wanted}
    assert names - pinned == set()


def test_pinned_packages_take_the_oldest_python_that_is_promised():
    import re
    from importlib.metadata import distributions

    from packaging.specifiers import SpecifierSet

    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = dict(line.lower().split("==") for line in lines if "==" in line and not line.startswith("#"))
    asked = {}
    for found in distributions():
        name = re.sub(r"[._-]+", "-", found.metadata["Name"]).lower()
        if pinned.get(name) == found.version.lower():
            asked[name] = found.metadata.get("Requires-Python", "")
    assert len(asked) > 100  # Debian 12 has 3.11.2, and the promise is 3.11
    assert [name for name, python in asked.items() if not SpecifierSet(python).contains("3.11.2")] == []
