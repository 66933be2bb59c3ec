"""CONTRIBUTING.md: every example is short and flies."""

from __future__ import annotations

import pytest

from tests.outside.conftest import examples

CONTRACTS = {
    "own_policy.py", "own_law.py", "own_sensor.py", "own_mapper.py", "own_vehicle.py",
    "own_navigation.py", "own_control.py", "own_tasking.py", "own_ground.py", "own_environment.py",
}  # fmt: skip


def test_there_is_an_example_of_every_contract():
    assert set(examples()) == CONTRACTS


@pytest.mark.parametrize("name", sorted(CONTRACTS))
def test_examples_are_short(name):
    assert len(examples()[name].splitlines()) <= 40
