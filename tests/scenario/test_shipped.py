"""The scenarios that come with the package."""

from __future__ import annotations

import tomllib

import pytest

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario, shipped
from tests.worlds import SCENARIOS


def test_every_scenario_is_shipped_under_its_name():
    files = [path for folder in ("", "landers") for path in (SCENARIOS / folder).glob("*.toml")]
    assert sorted(shipped.names()) == sorted(path.stem for path in files)
    assert shipped.description_of(shipped.path_of("hirise")).startswith("Measured Martian relief")
    told = tomllib.loads((SCENARIOS.parent / "pyproject.toml").read_text())
    held = told["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    assert held == {"scenarios": "lunarsim/shipped"}


@pytest.mark.parametrize("name", ["hirise", "golombek"])
def test_a_copy_is_the_scenario_with_its_data(name, tmp_path):
    target = tmp_path / "mine.toml"
    written = shipped.copy_to(name, target)
    assert written[0] == target
    mine, theirs = Scenario.load(target), Scenario.load(shipped.path_of(name))
    if name == "hirise":
        assert mine.terrain.path == tmp_path / "data" / theirs.terrain.path.name
        assert mine.terrain.path.read_bytes() == theirs.terrain.path.read_bytes()
        mine = mine.changed(terrain={"path": str(theirs.terrain.path)})
    assert mine == theirs
    assert target.read_bytes() == shipped.path_of(name).read_bytes()


def test_nothing_is_written_over(tmp_path):
    shipped.copy_to("hirise", tmp_path / "a.toml")
    shipped.copy_to("hirise", tmp_path / "b.toml")  # the same data again
    with pytest.raises(InputError, match="a file that does not exist yet"):
        shipped.copy_to("hirise", tmp_path / "a.toml")
    (tmp_path / "data" / "hirise_dteec_010228_1490_crop.tif").write_bytes(b"mine")
    with pytest.raises(InputError, match="a file that does not exist yet"):
        shipped.copy_to("hirise", tmp_path / "c.toml")
    assert not (tmp_path / "c.toml").exists()


def test_a_name_that_is_none_names_the_nearest():
    with pytest.raises(InputError, match="Did you mean 'hirise'"):
        shipped.path_of("hiris")


def test_a_name_stands_for_its_file_where_no_file_has_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    from pathlib import Path

    assert shipped.found(Path("golombek")) == shipped.path_of("golombek")
    (tmp_path / "golombek").write_text("")
    assert shipped.found(Path("golombek")) == Path("golombek")
    for given, words in (
        ("nothing.toml", "an existing TOML file.*`lunarsim scenario list`"),
        ("hirisee", "Did you mean 'hirise'"),
    ):
        with pytest.raises(InputError, match=words):
            shipped.found(Path(given))
