"""Keys of earlier versions: refused with the new name, and renamed by the upgrade."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner

import lunarsim
from lunarsim.campaign.dispersions import Dispersions
from lunarsim.campaign.distributions import Uniform
from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.rng import RandomStreams, flight_seed
from lunarsim.scenario import Scenario, layout
from lunarsim.scenario.renamed_keys import (
    RENAMED,
    RENAMED_SCENARIOS,
    RENAMED_VALUES,
    current_path,
    first_path,
    pattern_of,
)
from lunarsim.scenario.upgrade import upgrade_file, upgrade_text

OLD = """\
# A scenario of an earlier version.
[variation]          # per flight
load_kg = 20.0

[policy]
kind = "nearest-safe"
enough = 0.95  # p_safe

[sensors.flash]
kind = "flash-lidar"
half_width = 0.1
"late_s" = 0.0

[mappers]
rocks = { kind = "shadow", shapes = "told", hazard_diameter_m = 0.5 }
all.kind = "fused"
all.of = [
    "dem",  # elevations
    'rocks',
]

[[notes]]
text = '''
[variation]
load_kg = 3'''
"""


# A kind for each table that needs one.
KINDS = {
    "mappers": "quadtree", "sensors": "imu", "terminal_descent": "velocity-null",
    "vehicle": "jet-lander",
}  # fmt: skip


@pytest.mark.parametrize("old", [key for key in RENAMED if "." in key])
def test_each_old_key_is_refused_with_its_new_name(old):
    table, *steps = old.replace("*", "one").split(".")
    value = {steps[-1]: 1.0}
    for step in reversed(steps[:-1]):
        value = value if step == "one" else {step: value}
    if table in KINDS:
        value = {"kind": KINDS[table]} | value
    with pytest.raises(InputError) as caught:
        Scenario.from_dict({table: {"one": value} if "*" in old else value})
    assert caught.value.field == old.replace("*", "one")
    assert f"was renamed to {current_path(caught.value.field)}." in str(caught.value)


@pytest.mark.parametrize("old", [key for key in RENAMED if "." not in key])
def test_each_old_table_is_refused_with_its_new_name(old):
    with pytest.raises(InputError, match=f"was renamed to {RENAMED[old]}"):
        Scenario.from_dict({old: {}})


def test_removing_an_old_table_is_refused_too():
    with pytest.raises(InputError, match="was renamed to terminal_descent"):
        Scenario.from_dict({}).changed(descent=None)


def test_an_upgrade_changes_names_and_nothing_else(tmp_path):
    path = tmp_path / "old.toml"
    path.write_text(OLD)
    changes = upgrade_file(path)
    assert changes == [
        "variation -> domain_randomization", "load_kg -> payload_kg", "enough -> p_safe_min",
        "half_width -> half_fov_tangent", "late_s -> latency_bias_s", "told -> expected",
        "hazard_diameter_m -> min_hazard_diameter_m", "of -> inputs",
    ]  # fmt: skip
    text = path.read_text()
    expected = OLD
    for change in changes[:1] + changes[2:]:
        old, new = change.split(" -> ")
        for before, after in (("[{}]", "[{}]"), ("\n{} =", "\n{} ="), ('"{}"', '"{}"'),
                              (", {} =", ", {} ="), ("all.{} ", "all.{} ")):  # fmt: skip
            expected = expected.replace(before.format(old), after.format(new), 1)
    assert text == expected.replace("load_kg", "payload_kg", 1)
    assert tomllib.loads(text)["notes"] == tomllib.loads(OLD)["notes"]
    assert upgrade_file(path) == [] and path.read_text() == text


def test_an_upgraded_scenario_flies_the_same_values():
    old = '[policy]\nkind = "nearest-safe"\nenough = 0.7\n[sun]\nmottle = 0.02\n'
    text, _ = upgrade_text(old)
    scenario = Scenario.from_toml(text)
    assert (scenario.policy.p_safe_min, scenario.sun.albedo_variation) == (0.7, 0.02)


def test_a_campaign_is_upgraded_where_it_has_keys_of_a_scenario():
    old = """
name = "variation"
scenario = "two_eyes"
[factors]
"policy.enough" = [0.5, 0.9]
[dispersions]
start_knowledge.position_m = { kind = "normal", mean = 0.0, sigma = 1.0 }
[[arms]]
name = "variation"
set = { policy = { kind = "fuel-aware", price = 0.1 }, "sun.mottle" = 0.1 }
[[correlations]]
keys = ["sun.mottle", "rocks.cover"]
"""
    new = tomllib.loads(upgrade_text(old)[0])
    assert new["scenario"] == "camera_and_lidar" and new["name"] == "variation"
    assert list(new["factors"]) == ["policy.p_safe_min"]
    assert list(new["dispersions"]["initial_uncertainty"]) == ["position_m"]
    (arm,) = new["arms"]
    assert arm["name"] == "variation"
    assert arm["set"] == {
        "policy": {"kind": "fuel-aware", "propellant_weight": 0.1}, "sun.albedo_variation": 0.1
    }  # fmt: skip
    assert new["correlations"][0]["keys"] == ["sun.albedo_variation", "rocks.cover"]


def test_both_names_of_a_key_are_refused_and_the_file_stays(tmp_path):
    path = tmp_path / "both.toml"
    path.write_text("policy.enough = 0.9\npolicy.p_safe_min = 0.8\n")
    before = path.read_bytes()
    ran = CliRunner().invoke(main, ["scenario", "upgrade", str(path)])
    assert ran.exit_code == 2 and path.read_bytes() == before


def test_the_command_prints_each_change(tmp_path):
    path = tmp_path / "old.toml"
    path.write_bytes(b"\xef\xbb\xbf[policy]\r\nkind = 'nearest-safe'\r\nenough = 0.9\r\n")
    ran = CliRunner().invoke(main, ["scenario", "upgrade", str(path)])
    assert ran.output.splitlines() == ["enough -> p_safe_min"]
    upgraded = b"\xef\xbb\xbf[policy]\r\nkind = 'nearest-safe'\r\np_safe_min = 0.9\r\n"
    assert path.read_bytes() == upgraded
    ran = CliRunner().invoke(main, ["scenario", "upgrade", str(path)])
    assert "no key to rename" in ran.output


def test_labels_of_random_streams_are_the_first_names_of_keys():
    assert first_path("far_terrain.level_sizes") == "surroundings.level_sizes"
    assert first_path("sensors.flash.latency_bias_s") == "sensors.flash.late_s"
    assert first_path("rocks.cover") == "rocks.cover"
    # Frozen: these numbers are part of published results.
    drawn = RandomStreams(flight_seed(1, 0)).get("dispersions.sun.mottle").random()
    laws = Dispersions({"sun.albedo_variation": Uniform(0.0, 1.0)}, seed=1)
    assert laws.uniforms(0) == pytest.approx([drawn], abs=0)


@pytest.mark.parametrize(("key", "old"), list(RENAMED_VALUES))
def test_no_old_value_is_accepted_anywhere(key, old):
    table, *rest = key.replace("*", "one").split(".")
    value = {rest[-1]: old}
    data = {table: {"one": {"kind": "shadow"} | value} if len(rest) > 1 else value}
    with pytest.raises(InputError):
        Scenario.from_dict(data)


@pytest.mark.parametrize("path", sorted(Path("scenarios").rglob("*.toml")), ids=str)
def test_files_of_the_package_have_current_names(path):
    assert upgrade_text(path.read_text(encoding="utf-8"))[1] == []


def test_keys_of_a_part_of_ones_own_keep_their_names():
    text = '[policy]\nkind = "mine:Policy"\nenough = 0.5\n[sun]\nmottle = 0.1\n'
    new, changes = upgrade_text(text)
    assert 'kind = "mine:Policy"\nenough = 0.5' in new
    assert changes == ["mottle -> albedo_variation"]


def test_a_link_is_followed_and_permissions_are_kept(tmp_path):
    real = tmp_path / "real.toml"
    real.write_text("policy.enough = 0.9\n")
    (tmp_path / "link.toml").symlink_to(real)
    real.chmod(0o640)
    upgrade_file(tmp_path / "link.toml")
    assert real.stat().st_mode & 0o777 == 0o640
    assert (tmp_path / "link.toml").is_symlink()
    assert real.read_text() == "policy.p_safe_min = 0.9\n"


def test_quoted_keys_with_escapes_are_read():
    assert upgrade_text('"policy"."\\u0065nough" = 0.9\n')[0] == '"policy"."p_safe_min" = 0.9\n'


def test_tables_of_named_parts_are_those_of_a_scenario():
    for table in layout.NAMED:
        assert pattern_of([table, "any", "key"]) == f"{table}.*.key"
    assert pattern_of(["policy", "kind", "key"]) == "policy.kind.key"


@pytest.mark.parametrize("given", ["two_eyes", "../all_eyes.toml"])
def test_an_old_name_of_a_scenario_is_refused_with_the_new_one(given):
    new = RENAMED_SCENARIOS[Path(given).stem]
    with pytest.raises(InputError, match=f"This scenario is now named {new}"):
        lunarsim.load_scenario(given)
