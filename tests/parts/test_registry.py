"""Parts found by name, by "module:Class" and by the entry points of other packages."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from importlib.metadata import EntryPoint

import pytest

from lunarsim.errors import InputError
from lunarsim.onboard.policies.library import Safest
from lunarsim.parts import CONTRACTS, kinds, registry, resolve
from lunarsim.scenario import Scenario


@pytest.fixture(autouse=True)
def _allowed(monkeypatch):
    names = __name__, "no.such.module", "broken_part", "quitter", "a_part_of_ones_own"
    monkeypatch.setenv("LUNARSIM_ALLOW_MODULES", ",".join(names))


@dataclass(frozen=True)
class MyPolicy:
    """A policy of somebody else."""

    patience: float = 3.0
    name: str = "mine"

    def decide(self, observation):
        """Stay."""


class NoDataclass:
    pass


def test_names_and_paths_give_classes():
    assert resolve("policy", "safest") is Safest
    assert resolve("policy", "lunarsim.onboard.policies.library:Safest") is Safest
    assert resolve("policy", f"{__name__}:MyPolicy") is MyPolicy
    for contract in CONTRACTS:
        for kind in kinds(contract):
            assert isinstance(resolve(contract, kind), type)


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("safset", "Did you mean 'safest'?"),
        ("x", "Known names: fuel-aware, library, nearest-safe"),
        ("no.such.module:Thing", "Python reports ModuleNotFoundError: No module named 'no'"),
        (f"{__name__}:Missing", "Python reports AttributeError"),
        (f"{__name__}:NoDataclass", "must name a dataclass"),
        (f"{__name__}:pytest", "must name a dataclass"),
        (":", 'must be a known name, or a class as "module:Class"'),
    ],
)
def test_what_is_no_part_is_explained(kind, says):
    with pytest.raises(InputError) as caught:
        resolve("policy", kind, "--policies")
    assert (caught.value.field, caught.value.value) == ("--policies", kind)
    assert says in str(caught.value)
    with pytest.raises(InputError) as caught:
        resolve("policy", kind)
    assert caught.value.field == "policy.kind"


def test_a_module_that_fails_to_import_names_what_it_raised(tmp_path, monkeypatch):
    (tmp_path / "broken_part.py").write_text("raise RuntimeError('no licence')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError, match=r"RuntimeError: no licence"):
        resolve("mapper", "broken_part:Mapper")


def test_a_scenario_takes_a_class_of_ones_own():
    scenario = Scenario.from_dict({"policy": {"kind": f"{__name__}:MyPolicy", "patience": 5.0}})
    assert scenario.policy.make() == MyPolicy(5.0)
    assert Scenario.from_toml(scenario.to_toml()) == scenario
    with pytest.raises(InputError) as caught:
        Scenario.from_dict({"policy": {"kind": f"{__name__}:MyPolicy", "patiense": 5.0}})
    assert caught.value.field == "policy.patiense"
    assert "Did you mean 'patience'" in str(caught.value)


def test_entry_points_add_names_but_take_none(monkeypatch):
    def points(group, search_path):
        own = {"lunarsim.policy": [EntryPoint("mine", f"{__name__}:MyPolicy", group)]}
        return own.get(group, []) + extra

    extra: list[EntryPoint] = []
    monkeypatch.setattr(registry, "installed_parts", points)
    assert kinds("policy")["mine"] == f"{__name__}:MyPolicy"
    assert "mine" not in kinds("mapper")
    assert resolve("policy", "mine", "entry-point") is MyPolicy
    extra.append(EntryPoint("safest", "other:Safest", "lunarsim.policy"))
    with pytest.raises(InputError, match=r"must have a unique name.*lunarsim\.onboard\.policies"):
        kinds("policy")


@dataclass
class Thawed:
    """A policy that can be changed under way."""

    name: str = "thawed"

    def decide(self, observation):
        """Stay."""


@dataclass(frozen=True)
class Greedy:
    """A policy with a field that tables have for themselves."""

    kind: str = "x"
    name: str = "greedy"

    def decide(self, observation):
        """Stay."""


@pytest.mark.parametrize(
    ("contract", "name", "words"),
    [
        ("policy", "Thawed", "must name a frozen dataclass"),
        ("policy", "Greedy", "a class without a field 'kind'"),
        (
            "navigation",
            "MyPolicy",
            "a class that defines 'build', as every navigation component must",
        ),
        ("control", "MyPolicy", "a class that defines 'torques'"),
        ("sensor", "MyPolicy", "a class that defines 'measurement_type'"),
    ],
)
def test_what_is_no_part_of_the_contract_is_refused(contract, name, words):
    with pytest.raises(InputError, match=words):
        resolve(contract, f"{__name__}:{name}")


def test_a_module_that_exits_is_an_error_not_an_exit(tmp_path, monkeypatch):
    (tmp_path / "quitter.py").write_text("raise SystemExit(5)")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(InputError, match="SystemExit"):
        resolve("policy", "quitter:Policy")


def test_a_part_of_ones_own_is_found_in_the_working_directory(tmp_path, monkeypatch):
    """By an installed command too, whose path does not begin there."""
    text = (
        "from dataclasses import dataclass\n"
        "from lunarsim.onboard.policies.library import NoDivert\n"
        "@dataclass(frozen=True)\nclass Mine(NoDivert):\n    pass\n"
    )
    (tmp_path / "a_part_of_ones_own.py").write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p not in ("", str(tmp_path))])
    assert resolve("policy", "a_part_of_ones_own:Mine").__name__ == "Mine"
    assert sys.path[-1] == str(tmp_path)


def test_entry_points_follow_the_search_path(tmp_path, monkeypatch):
    """The metadata of packages are read once, and again if the search path has changed."""
    assert "from_elsewhere" not in kinds("policy")
    metadata = tmp_path / "elsewhere-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: elsewhere\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[lunarsim.policy]\nfrom_elsewhere = elsewhere:P\n")
    with monkeypatch.context() as patch:
        patch.syspath_prepend(tmp_path)
        assert kinds("policy")["from_elsewhere"] == "elsewhere:P"
    assert "from_elsewhere" not in kinds("policy")


def test_a_class_that_a_session_defines_again_is_the_new_one(monkeypatch):
    monkeypatch.setenv("LUNARSIM_ALLOW_MODULES", "__main__")
    main = sys.modules["__main__"]
    for attempt in range(2):
        again = type("Again", (MyPolicy,), {"attempt": attempt})
        monkeypatch.setattr(main, "Again", dataclass(frozen=True)(again), raising=False)
        assert resolve("policy", "__main__:Again").attempt == attempt
