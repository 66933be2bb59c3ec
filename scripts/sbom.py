"""Write the software bill of materials (SBOM) of lunarsim: CycloneDX 1.6, JSON.

    python scripts/sbom.py > out/sbom.json

It lists the packages that `pip install lunarsim` needs in this environment, in the versions of
`requirements.lock`, with licence, package URL and dependencies. The lock file has no hashes;
therefore the SBOM has none.
"""

from __future__ import annotations

import json
import sys
import tomllib
import uuid
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

from packaging.licenses import InvalidLicenseExpression, canonicalize_license_expression
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from lunarsim import __version__

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "scripts"))

from licences_page import licence  # noqa: E402


def locked_versions() -> dict[str, str]:
    """Return the locked versions for this environment, by canonical name."""
    lines = (ROOT / "requirements.lock").read_text(encoding="utf-8").splitlines()
    pins = [Requirement(line) for line in lines if not line.startswith("#")]
    return {
        canonicalize_name(pin.name): next(iter(pin.specifier)).version
        for pin in pins
        if pin.marker is None or pin.marker.evaluate()
    }


def needed_names(requirements: list[str], extras: set[str]) -> dict[str, set[str]]:
    """Return the names that apply in this environment, each with its extras."""
    names: dict[str, set[str]] = {}
    for one in map(Requirement, requirements):
        if one.marker is None or any(one.marker.evaluate({"extra": e}) for e in extras | {""}):
            names.setdefault(canonicalize_name(one.name), set()).update(one.extras)
    return names


def resolve_dependencies(requirements: list[str]) -> dict[str, list[str]]:
    """Return every needed package with the names of its direct dependencies, by name.

    Raises
    ------
    SystemExit
        If a needed package is not installed.
    """
    graph: dict[str, list[str]] = {}
    waiting = list(needed_names(requirements, set()).items())
    while waiting:
        name, extras = waiting.pop()
        try:
            further = needed_names(distribution(name).requires or [], extras)
        except PackageNotFoundError:
            raise SystemExit(f"{name}: must be installed. Run `make sbom`.") from None
        known = graph.get(name)
        if known is None or not set(further) <= set(known):
            graph[name] = sorted({*(known or ()), *further})
            waiting.extend(further.items())
    return dict(sorted(graph.items()))


def component(name: str, version: str) -> dict[str, Any]:
    """Return the CycloneDX component of a package from PyPI.

    Raises
    ------
    SystemExit
        If another version than the locked one is installed, whose metadata may differ.
    """
    installed = distribution(name)
    if installed.version != version:
        raise SystemExit(f"{name}: must be version {version} as locked, got {installed.version}.")
    stated = licence(installed.metadata.json)
    try:
        licences = [{"expression": str(canonicalize_license_expression(stated))}]
    except InvalidLicenseExpression:
        licences = [{"license": {"name": stated}}]
    purl = f"pkg:pypi/{name}@{version}"
    return {
        "type": "library",
        "bom-ref": purl,
        "name": installed.metadata["Name"],
        "version": version,
        "licenses": licences,
        "purl": purl,
    }


def bill_of_materials() -> dict[str, Any]:
    """Return the CycloneDX document of the dependencies in `pyproject.toml`."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    graph, locked = resolve_dependencies(project["dependencies"]), locked_versions()
    if missing := sorted(set(graph) - set(locked)):
        raise SystemExit(f"requirements.lock: must pin {', '.join(missing)}. Run `make lock`.")
    components = {name: component(name, locked[name]) for name in graph}
    refs = {name: one["bom-ref"] for name, one in components.items()}
    itself = f"pkg:pypi/{project['name']}@{__version__}"
    direct = needed_names(project["dependencies"], set())
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": uuid.uuid4().urn,
        "version": 1,
        "metadata": {
            "timestamp": datetime.now(UTC).isoformat(timespec="seconds"),
            "tools": {"components": [{"type": "application", "name": "lunarsim/scripts/sbom.py"}]},
            "component": {
                "type": "application",
                "bom-ref": itself,
                "name": project["name"],
                "version": __version__,
                "licenses": [{"expression": project["license"]}],
                "purl": itself,
            },
        },
        "components": list(components.values()),
        "dependencies": [
            {"ref": itself, "dependsOn": sorted(refs[name] for name in direct)},
            *(
                {"ref": refs[name], "dependsOn": [refs[one] for one in needs]}
                for name, needs in graph.items()
            ),
        ],
    }


if __name__ == "__main__":
    print(json.dumps(bill_of_materials(), indent=2))
