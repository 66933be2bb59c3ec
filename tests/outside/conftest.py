"""A package as somebody outside would write it, made of the examples in CONTRIBUTING.md."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from lunarsim.scenario import Scenario
from tests.conftest import ROOT

_BLOCK = re.compile(r"```python\n# (\w+\.py)\n(.*?)```", re.DOTALL)


def examples() -> dict[str, str]:
    """Return the files that CONTRIBUTING.md shows, by name."""
    return dict(_BLOCK.findall((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")))


@pytest.fixture(scope="session")
def outside(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the package, on the path of this process and of those that it starts."""
    folder = tmp_path_factory.mktemp("outside")
    for name, text in examples().items():
        (folder / name).write_text(text, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        patch.setenv("PYTHONPATH", ":".join([str(folder), *filter(None, sys.path)]))
        modules = (name.removesuffix(".py") for name in examples())
        patch.setenv("LUNARSIM_ALLOW_MODULES", ",".join(modules))
        yield folder


@pytest.fixture
def small(outside: Path) -> Scenario:
    """A quick flight over rolling ground."""
    return Scenario.from_dict(
        {
            "name": "outside",
            "terrain": {"size_m": 80.0},
            "rocks": {"cover": 0.04, "min_diameter_m": 0.4},
            "sensors": {
                "imu": {"kind": "imu"},
                "fix": {"kind": "navigation-fix"},
                "flash": {"kind": "flash-lidar", "rows": 96, "cols": 96},
            },
            # Of so few returns a calibrated map would call next to nothing safe.
            "mappers": {
                "dem": {
                    "kind": "gaussian-dem",
                    "posting_m": 0.5,
                    "size_m": 50.0,
                    "safety": "level",
                }
            },
        }
    )
