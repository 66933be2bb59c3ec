"""Prints the page of licences: `python scripts/licences_page.py > docs/licences.md`.

It asks pip which packages the project and each extra would install, without installing them. Older
releases than pip 25 do not report licences that are SPDX expressions.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent

HEAD = """# Licences of dependencies

Made by `make lock` from what the packages state, in the versions of `requirements.lock`, for Python
{python} on Linux. Lunarsim itself is under the Apache License 2.0. The first table is what
`pip install lunarsim` installs; the others add what an extra needs beside it.
"""

# Packages that state no licence in their metadata; from the licence file in the distribution.
BY_FILE = {"embreex": "BSD-2-Clause", "ptyprocess": "ISC", "qoco": "BSD-3-Clause"}
# SPDX identifiers of names in classifiers and free text; "BSD" alone has 2 or 3 clauses.
SPDX = {
    "2-clause BSD": "BSD-2-Clause",
    "3-Clause BSD License": "BSD-3-Clause",
    "Apache 2.0": "Apache-2.0",
    "Apache License 2.0": "Apache-2.0",
    "Apache Software License": "Apache-2.0",
    "BSD 2-Clause License": "BSD-2-Clause",
    "BSD License": "BSD",
    "GNU Lesser General Public License v3 or later (LGPLv3+)": "LGPL-3.0-or-later",
    "ISC License": "ISC",
    "ISC License (ISCL)": "ISC",
    "ISC license": "ISC",
    "MIT License": "MIT",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "New BSD": "BSD-3-Clause",
    "Python Software Foundation License": "PSF-2.0",
}


def licence(metadata: dict[str, Any]) -> str:
    """Return the licence that a package states, "not stated" if it states none.

    Examples
    --------
    >>> licence({"name": "a", "license_expression": "MIT"})
    'MIT'
    >>> licence({"name": "b", "classifier": ["License :: OSI Approved :: BSD License"]})
    'BSD'
    >>> licence({"name": "c"})
    'not stated'
    """
    if expression := metadata.get("license_expression"):
        return str(expression)
    if metadata["name"] in BY_FILE:
        return BY_FILE[metadata["name"]]
    stated = str(metadata.get("license") or "").strip()
    if stated and "\n" not in stated and len(stated) <= 60:
        return SPDX.get(stated, stated)
    named = [
        one.rpartition(" :: ")[2]
        for one in metadata.get("classifier", ())
        if one.startswith("License :: ") and not one.endswith("OSI Approved")
    ]
    return " and ".join(SPDX.get(one, one) for one in named) or "not stated"


def installed(extra: str) -> dict[str, dict[str, Any]]:
    """Return the metadata of all packages that the project and an extra would install, by name."""
    wanted = f"{ROOT}[{extra}]" if extra else str(ROOT)
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        subprocess.run(
            [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check",
             "--dry-run", "--ignore-installed", "--report", report,
             "--constraint", ROOT / "requirements.lock", wanted],
            check=True, stdout=sys.stderr,
        )  # fmt: skip
        found = json.loads(report.read_text(encoding="utf-8"))["install"]
    packages = {one["metadata"]["name"].lower(): one["metadata"] for one in found}
    return {name: data for name, data in sorted(packages.items()) if name != "lunarsim"}


def table(packages: dict[str, dict[str, Any]]) -> str:
    """Return a table of packages, versions and licences."""
    rows = [
        f"| {data['name']} | {data['version']} | {licence(data)} |" for data in packages.values()
    ]
    return "\n".join(("| package | version | licence |", "| --- | --- | --- |", *rows)) + "\n"


def page() -> str:
    """Return the page as Markdown."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    base = installed("")
    out = [HEAD.format(python=f"{sys.version_info.major}.{sys.version_info.minor}"), table(base)]
    for extra in project["optional-dependencies"]:
        if extra == "docs":  # a part of dev
            continue
        print(f"extra {extra}", file=sys.stderr)
        more = {name: data for name, data in installed(extra).items() if name not in base}
        out.append(f"## Extra {extra}\n\n{table(more)}")
    return "\n".join(out)


if __name__ == "__main__":
    print(page(), end="")
