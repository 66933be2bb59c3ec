"""A TOML file of any shape is read or refused by one error, in little memory and time."""

from __future__ import annotations

import pytest

from lunarsim.campaign.spec import CampaignSpec
from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.scenario.files import MAX_TOML_BYTES, parsed_toml
from tests.security import fuzz

HUGE = "0x" + "F" * 20_000
DEEP = ".".join("a" * 100_000)  # 1 GB of memory for each 10,000 parts, 100 GB for these


@pytest.mark.parametrize(
    "text",
    [
        f"gravity_m_s2 = {HUGE}", f"unknown = {HUGE}", f"name = {HUGE}", f"rocks = [{HUGE}]",
        f"terrain = {{size_m = {HUGE}}}", f"start = {{position_m = [{HUGE}, 0, 0]}}",
        f"factors = {{a = [{HUGE}]}}", "seed = 9223372036854775808",
        f"{DEEP} = 1", f"[{DEEP}]", f"name.{DEEP} = 1", f"terrain = {{{DEEP} = 1}}",
        f"{DEEP.replace('.', ' . ')} = 1", ".".join(["'a'"] * 50_000) + " = 1",
        f"factors.{'a.' * 60}b = 1", f"dispersions = {'{a=' * 60}1{'}' * 60}",
        "a = " + "[" * 99_999,
        "x" * 3_000_000, '"' * 999_999, "#" * (MAX_TOML_BYTES + 1), "\\" * 999,
    ],
    ids=lambda text: f"{text[:20]} {len(text)}",
)  # fmt: skip
def test_odd_tables_are_one_short_error(tmp_path, text):
    path = tmp_path / "s.toml"
    path.write_text(text)
    for read in (Scenario.load, CampaignSpec.load, lambda path: Scenario.from_toml(text)):
        with fuzz.at_most(10.0), pytest.raises(InputError) as caught:
            read(path)
        assert len(str(caught.value).replace(str(path), "")) < 250


def test_plain_tables_stay_readable():
    points = ", ".join(["1.5"] * 500)
    assert parsed_toml(f'a = [{points}]\ntext = "{"wait... " * 90}"')["a"] == [1.5] * 500
    assert parsed_toml(f"a = {-(2**63)}\nb = {2**63 - 1}")["b"] == 2**63 - 1


def test_a_number_too_long_to_show_is_still_an_input_error():
    with pytest.raises(InputError, match="too long to show"):
        Scenario.from_dict({"gravity_m_s2": 16**20_000})


@pytest.mark.parametrize("key", ["name", "description"])
def test_texts_hold_no_commands_for_a_terminal(key):
    for odd in ("\x1b]0;x\x07", "\x9b31m", "\x00"):
        with pytest.raises(InputError, match=f"{key}: .*control characters"):
            Scenario.from_dict({key: odd})
    text = "Mare\u202fImbrium, \u00fc, \u6708"
    assert Scenario.from_dict({key: text}).to_dict()[key] == text
