"""Flights of a study in a file that a later run goes on from."""

import json

import pytest

from lunarsim.campaign import flight_store
from lunarsim.campaign.flight_store import FlightStore
from lunarsim.errors import InputError

SETTINGS = {"seed": 3, "path": "modified"}


def test_what_is_kept_is_there_again(tmp_path):
    file = tmp_path / "folder" / "flights.json"
    kept = FlightStore(file, SETTINGS)
    kept.keep("a / 0", {"clear": 0.5, "landed": True})
    kept.keep("b / 0", {"clear": 0.25, "landed": False})
    again = FlightStore(file, SETTINGS)
    assert again.flights == kept.flights
    assert list(again.flights) == ["a / 0", "b / 0"]
    again.keep("c / 0", {"clear": 0.0, "landed": True})
    assert len(FlightStore(file, SETTINGS).flights) == 3
    assert [p.name for p in file.parent.iterdir()] == ["flights.json"]


def test_without_a_file_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    kept = FlightStore(None, SETTINGS)
    kept.keep("a", {"clear": 1.0})
    assert kept.flights == {"a": {"clear": 1.0}}
    assert list(tmp_path.iterdir()) == []


def test_a_write_that_breaks_off_leaves_the_file_as_it_was(tmp_path, monkeypatch):
    file = tmp_path / "flights.json"
    kept = FlightStore(file, SETTINGS)
    kept.keep("a", {"clear": 1.0})
    before = file.read_bytes()
    with pytest.raises(TypeError):
        kept.keep("b", {"clear": object()})
    assert file.read_bytes() == before
    assert FlightStore(file, SETTINGS).flights == {"a": {"clear": 1.0}}


@pytest.mark.parametrize(
    "text",
    ["", "{", "[1, 2]", "null", '{"settings": {"seed": 3, "path": "modified"}}',
     '{"settings": {"seed": 3, "path": "modified"}, "flights": [1]}',
     '{"settings": {"seed": 3, "path": "modified"}, "flights": {"a": 1}}'],
)  # fmt: skip
def test_a_file_that_is_none_is_refused_and_left(tmp_path, text):
    file = tmp_path / "flights.json"
    file.write_text(text)
    with pytest.raises(InputError, match=r"flights\.file: must be a"):
        FlightStore(file, SETTINGS)
    assert file.read_text() == text


def test_what_is_no_text_or_a_folder_is_refused(tmp_path):
    file = tmp_path / "flights.json"
    file.write_bytes(b"\xff\xfe\x00\x01")
    for path in (file, tmp_path):
        with pytest.raises(InputError, match=r"flights\.file"):
            FlightStore(path, SETTINGS)


def test_flights_of_another_study_are_refused(tmp_path):
    file = tmp_path / "flights.json"
    FlightStore(file, SETTINGS).keep("a", {"clear": 1.0})
    with pytest.raises(InputError, match=r"settings\.seed is 3 in the file and 4 now"):
        FlightStore(file, {**SETTINGS, "seed": 4})


def test_flights_of_other_code_are_counted(tmp_path, monkeypatch):
    file = tmp_path / "flights.json"
    monkeypatch.setattr(flight_store, "code_digest", lambda: "before")
    FlightStore(file, SETTINGS).keep("a", {"clear": 1.0})
    assert FlightStore(file, SETTINGS).outdated_count == 0
    monkeypatch.setattr(flight_store, "code_digest", lambda: "after")
    kept = FlightStore(file, SETTINGS)
    kept.keep("b", {"clear": 1.0})
    assert kept.outdated_count == 1
    kept.keep("a", {"clear": 0.5})
    assert FlightStore(file, SETTINGS).outdated_count == 0
    # Of a file that does not say, nobody knows.
    data = json.loads(file.read_text())
    del data["code"]
    file.write_text(json.dumps(data))
    assert FlightStore(file, SETTINGS).outdated_count == 2
