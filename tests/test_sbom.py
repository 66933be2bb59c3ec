"""The software bill of materials: fields of CycloneDX 1.6, and every dependency of the project."""

from __future__ import annotations

import re
import tomllib
from datetime import datetime

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from scripts import sbom
from tests.worlds import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.fixture(scope="module")
def bom():
    return sbom.bill_of_materials()


def test_required_fields_are_there(bom):
    assert (bom["bomFormat"], bom["specVersion"], bom["version"]) == ("CycloneDX", "1.6", 1)
    digits = r"[0-9a-f]"
    assert re.fullmatch(
        rf"urn:uuid:{digits}{{8}}-({digits}{{4}}-){{3}}{digits}{{12}}", bom["serialNumber"]
    )
    assert datetime.fromisoformat(bom["metadata"]["timestamp"]).tzinfo is not None
    for one in (bom["metadata"]["component"], *bom["components"]):
        assert one["type"] in {"application", "library"}
        assert one["name"] and one["version"]
        assert one["purl"] == f"pkg:pypi/{canonicalize_name(one['name'])}@{one['version']}"
        (licence,) = one["licenses"]
        stated = licence.get("expression") or licence["license"]["name"]
        assert stated and stated != "not stated", one["name"]


def test_every_dependency_of_the_project_is_in_it_as_locked(bom):
    lines = (ROOT / "requirements.lock").read_text(encoding="utf-8").splitlines()
    versions = {canonicalize_name(one["name"]): one["version"] for one in bom["components"]}
    assert len(versions) == len(bom["components"])
    for wanted in map(Requirement, PROJECT["dependencies"]):
        assert wanted.specifier.contains(versions[canonicalize_name(wanted.name)])
    for name, version in versions.items():
        assert any(line.split(" ")[0] == f"{name}=={version}" for line in lines), name
    # Packages for development only are not in it.
    assert not {"pytest", "ruff", "sphinx"} & set(versions)


def test_the_graph_joins_all_components(bom):
    needs = {one["ref"]: one["dependsOn"] for one in bom["dependencies"]}
    reached, waiting = set(), [bom["metadata"]["component"]["bom-ref"]]
    while waiting:
        if (ref := waiting.pop()) not in reached:
            reached.add(ref)
            waiting += needs[ref]
    assert reached - {bom["metadata"]["component"]["bom-ref"]} == {
        one["bom-ref"] for one in bom["components"]
    }
    assert len(needs[bom["metadata"]["component"]["bom-ref"]]) == len(PROJECT["dependencies"])


def test_packages_that_are_missing_or_of_another_version_are_refused():
    with pytest.raises(SystemExit, match="no-such-package: must be installed"):
        sbom.resolve_dependencies(["no-such-package"])
    with pytest.raises(SystemExit, match="numpy: must be version 0 as locked"):
        sbom.component("numpy", "0")


def test_extras_bring_their_packages():
    plain = sbom.needed_names(["a", 'b ; extra == "x"'], set())
    assert plain == {"a": set()}
    assert sbom.needed_names(["a[y]", 'b ; extra == "x"'], {"x"}) == {"a": {"y"}, "b": set()}
