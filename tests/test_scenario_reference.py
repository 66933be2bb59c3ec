"""What scenario files may hold, in words."""

from __future__ import annotations

from dataclasses import fields, replace
from importlib.metadata import EntryPoint

from click.testing import CliRunner

from lunarsim.cli import main
from lunarsim.parts import CONTRACTS, registry, settings_of
from lunarsim.scenario.reference import parts_list, reference_text
from lunarsim.sensors.imu import ImuSettings
from tests.conftest import ROOT


def test_every_part_is_listed_with_what_it_is():
    lines = parts_list()
    assert len(lines) == sum(len(c.kinds) for c in CONTRACTS.values())
    assert all(len(line) > 40 and "cannot be loaded" not in line for line in lines)
    done = CliRunner().invoke(main, ["parts", "policy"])
    assert done.output.splitlines() == parts_list("policy")
    wrong = CliRunner().invoke(main, ["parts", "polcy"])
    assert wrong.exit_code == 2
    assert "Did you mean 'policy'?" in wrong.output


def test_every_key_has_a_meaning():
    rows = [line for line in reference_text(markdown=True).splitlines() if line.startswith("| `")]
    assert len(rows) > 150
    assert not [row for row in rows if not row.rstrip(" |").split(" | ")[-1].strip()]
    without = [row for row in rows if row.endswith("|  |")]
    assert not without


def test_a_part_that_cannot_be_loaded_is_named_and_the_rest_is_printed(monkeypatch):
    def points(group, search_path):
        own = {"lunarsim.policy": [EntryPoint("lost", "no_such_module:Policy", group)]}
        return own.get(group, [])

    monkeypatch.setattr(registry, "installed_parts", points)
    assert [line for line in parts_list("policy") if "lost" in line and "cannot be loaded" in line]
    whole = reference_text(markdown=True)
    assert "cannot be loaded: " in whole
    assert "`relief_scale`" in whole
    assert all(kind != "lost" for kind, _ in registry.loadable_parts("policy"))


def test_a_scenario_is_printed_whole():
    done = CliRunner().invoke(main, ["scenario", "check", str(ROOT / "scenarios" / "hirise.toml")])
    assert done.exit_code == 0
    assert "[control]" in done.output
    assert "frequency_rad_s = 4.0" in done.output
    wrong = CliRunner().invoke(main, ["scenario", "check", "nowhere.toml"])
    assert wrong.exit_code == 2


def test_defaults_of_nested_tables_are_those_that_fly():
    """Also where a scenario gives only one key of such a table."""
    text = reference_text(markdown=True)
    table = settings_of(ImuSettings)
    unit = table().make()
    for triad in ("gyroscopes", "accelerometers"):
        errors = getattr(unit, triad)
        for field in fields(errors):
            key = f"{triad}.{field.name}" + "_s" * (field.name == "correlation_time")
            assert f"| `{key}` | {getattr(errors, field.name):.6g} |" in text
    partial = table.model_validate({"gyroscopes": {"bias": 0.0}}).make()
    assert partial.gyroscopes == replace(unit.gyroscopes, bias=0.0)
    assert partial.accelerometers == unit.accelerometers
