"""Tables of shadows are kept for a user, whole, and the same to the bit."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.onboard.perception.table_cache import cached_table


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "lunarsim" / "tables"


class Maker:
    def __init__(self):
        self.made = 0

    def __call__(self):
        self.made += 1
        return np.random.default_rng(4).normal(size=(3, 4))


def test_a_table_is_made_once_and_read_to_the_bit(folder):
    make = Maker()
    first, second = cached_table("shadows", "20 deg", make), cached_table("shadows", "20 deg", make)
    assert make.made == 1
    np.testing.assert_array_equal(first, second)
    cached_table("shadows", "21 deg", make)
    assert make.made == 2
    assert len(list(folder.iterdir())) == 2


@pytest.mark.parametrize("damage", [b"", b"no archive", "half"])
def test_a_damaged_file_is_generated_again(folder, damage):
    make = Maker()
    table = cached_table("shadows", "20 deg", make)
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2] if damage == "half" else damage)
    np.testing.assert_array_equal(cached_table("shadows", "20 deg", make), table)
    assert make.made == 2
    assert file.read_bytes() == whole


def test_without_a_cache_tables_are_made_each_time(tmp_path, monkeypatch):
    (tmp_path / "lunarsim").write_text("a file where a folder should be")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    make = Maker()
    table = cached_table("shadows", "20 deg", make)
    np.testing.assert_array_equal(cached_table("shadows", "20 deg", make), table)
    assert make.made == 2
