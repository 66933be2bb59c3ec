"""Any value at any key of a scenario file: taken as it is, or refused by its name."""

from __future__ import annotations

import math
import tomllib

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from lunarsim.errors import InputError
from lunarsim.parts import PartSettings, kinds, resolve, settings_of
from lunarsim.scenario import Scenario, layout
from lunarsim.scenario.scenario_warnings import warnings_for


def _keys(model: type[PartSettings], before: tuple[str, ...]):
    for key, field in model.model_fields.items():
        nested = field.annotation
        if isinstance(nested, type) and issubclass(nested, PartSettings):
            yield from _keys(nested, (*before, key))
        yield *before, key


def _every_key():
    """Yield table, kind or None, and the path of every key that a file may hold."""
    for name, of in (layout.FIXED | layout.OPTIONAL).items():
        for path in _keys(settings_of(of), ()):
            yield (name,), None, path
    chosen = {name: contract for name, (contract, _) in layout.SELECTED.items()}
    for name, contract in (chosen | layout.OPTIONAL_SELECTED).items():
        for kind in kinds(contract):
            yield from (
                ((name,), kind, path) for path in _keys(settings_of(resolve(contract, kind)), ())
            )
    for name, (contract, default) in layout.NAMED.items():
        own = "flash" if name == "sensors" else next(iter(default), "fault")
        for kind in kinds(contract):
            keys = _keys(settings_of(resolve(contract, kind)), ())
            yield from (((name, own), kind, path) for path in keys)
    yield from (((), None, (key,)) for key in ("name", "description", "gravity_m_s2"))


KEYS = list(_every_key())
NUMBERS = st.one_of(
    st.sampled_from([0, -1, 1, 1e-300, 1e300, 1e9, -1e9, 0.5, 45.0, 90.0, 10**30, True, math.inf]),
    st.floats(), st.integers(-(10**6), 10**6), st.floats(0.0, 10.0),
)  # fmt: skip
VALUES = st.one_of(
    NUMBERS,
    st.sampled_from(["", "x", "1100", "imu:Imu", "none", "../x.tif", "a\0b", "none:none:", ":"]),
    st.text(max_size=4),
    st.lists(NUMBERS, max_size=4),
    st.just({}),
    st.dictionaries(st.text(max_size=3), NUMBERS, max_size=2),
    st.lists(st.lists(NUMBERS, max_size=2), max_size=2),
)


def _tables(table, kind, path, value):
    inner = value
    for key in reversed(path):
        inner = {key: inner}
    if kind is not None:
        inner = {"kind": kind} | inner
    if table[:1] == ("sensor_faults",):
        inner = {"sensor": "flash"} | inner
    for name in reversed(table):
        inner = {name: inner}
    return inner


def _refused_or_whole(tables):
    try:
        scenario = Scenario.from_dict(tables)
    except InputError as error:
        assert error.field and error.problem
        assert "\n" not in str(error)
        # Of the file, or of one of its tables: what contradicts it may stand in another.
        assert error.field.split(".")[0] in {*Scenario.__dataclass_fields__, *tables}
        return
    text = scenario.to_toml()
    assert Scenario.from_dict(tomllib.loads(text)) == scenario
    assert all("\n" not in note for note in warnings_for(scenario))


def test_all_keys_are_tried():
    assert len(KEYS) > 300


@pytest.mark.parametrize("part", range(4))
def test_one_value_at_any_key(part):
    @settings(max_examples=150)
    @given(st.sampled_from(KEYS[part::4]), VALUES)
    def tried(key, value):
        table, kind, path = key
        _refused_or_whole(_tables(table, kind, path, value))

    tried()


@settings(max_examples=60)
@given(st.lists(st.tuples(st.sampled_from(KEYS), VALUES), min_size=2, max_size=4))
@example([(((), None, ("self",)), 1)])
def test_several_values_at_once(chosen):
    tables: dict = {}
    for (table, kind, path), value in chosen:
        _laid(tables, _tables(table, kind, path, value))
    _refused_or_whole(tables)


def _laid(tables, more):
    for key, value in more.items():
        if isinstance(tables.get(key), dict) and isinstance(value, dict):
            _laid(tables[key], value)
        else:
            tables[key] = value


@settings(max_examples=150)
@given(st.binary(max_size=40))
@example(b"")
@example(b"\xef\xbb\xbf")
@example(b"# nothing but this\n")
@example(b"a=" + b"[" * 3000)
@example(b"\xff\xfe")
def test_any_bytes_as_a_file(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("bytes") / "s.toml"
    path.write_bytes(content)
    with pytest.raises(InputError):
        Scenario.load(path)


def test_a_byte_order_mark_is_read_over(tmp_path):
    path = tmp_path / "s.toml"
    path.write_bytes(b'\xef\xbb\xbfname = "marked"\n')
    assert Scenario.load(path).name == "marked"
