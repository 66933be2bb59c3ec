"""The lock file pins every dependency at a version that the project's metadata allows."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from scripts.licences_page import HEAD, licence

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
# PyTorch comes in builds for each processor, which the user chooses.
WANTED = [
    (name, requirement)
    for name, requirements in {
        "": PROJECT["dependencies"],
        **PROJECT["optional-dependencies"],
    }.items()
    for requirement in map(Requirement, requirements)
    if name != "rl"
]


@pytest.fixture(scope="module")
def locked():
    lines = (ROOT / "requirements.lock").read_text(encoding="utf-8").splitlines()
    found: dict[str, list[Requirement]] = {}
    for line in lines:
        if not line.startswith("#"):
            requirement = Requirement(line)
            found.setdefault(canonicalize_name(requirement.name), []).append(requirement)
    return found


@pytest.mark.parametrize("python", ["3.11", "3.12", "3.13"])
@pytest.mark.parametrize(("extra", "wanted"), WANTED, ids=lambda one: str(one) or "base")
def test_one_allowed_version_is_locked(locked, extra, wanted, python):
    here = {"python_version": python, "python_full_version": f"{python}.1", "sys_platform": "linux"}
    pins = [
        one for one in locked[canonicalize_name(wanted.name)]
        if one.marker is None or one.marker.evaluate(here)
    ]  # fmt: skip
    assert len(pins) == 1
    (pin,) = pins[0].specifier
    assert pin.operator == "==" and wanted.specifier.contains(pin.version)


def test_the_page_of_licences_names_a_licence_of_all_that_is_locked(locked):
    page = (ROOT / "docs" / "about" / "licences.md").read_text(encoding="utf-8")
    rows = [row.strip("| ").split(" | ") for row in page.splitlines() if row.startswith("| ")]
    licences = {canonicalize_name(row[0]): row[-1] for row in rows}
    here = {"python_version": "3.11", "python_full_version": "3.11.7", "sys_platform": "linux"}
    for name, pins in locked.items():
        if any(one.marker is None or one.marker.evaluate(here) for one in pins):
            assert licences.get(name, "not stated") != "not stated", name


def test_the_page_of_licences_begins_as_its_script_prints_it():
    page = (ROOT / "docs" / "about" / "licences.md").read_text(encoding="utf-8")
    assert page.startswith(HEAD.format(python="3.11"))


def test_stated_licences_are_read():
    assert licence({"name": "a", "license_expression": "MIT"}) == "MIT"
    classifier = ["License :: OSI Approved", "License :: OSI Approved :: BSD License"]
    assert licence({"name": "b", "classifier": classifier}) == "BSD"
    assert licence({"name": "c", "license": "Apache License 2.0"}) == "Apache-2.0"
    assert licence({"name": "d"}) == "not stated"
