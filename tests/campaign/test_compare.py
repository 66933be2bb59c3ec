from __future__ import annotations

import json
import shutil

import pandas as pd
import pytest

from lunarsim import viz
from lunarsim.campaign import compare
from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from tests.worlds import TINY_FLIGHT


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return Scenario.from_dict(TINY_FLIGHT)


def undrawn(*_, **__):
    """Stand in for the picture of one flight: `result` has them drawn."""


@pytest.fixture(scope="module")
def result(scenario, tmp_path_factory):
    out = tmp_path_factory.mktemp("one") / "out"
    return compare(scenario, ["no-divert", "safest"], flights=2, seed=4, jobs=1, out=out), out


def test_results_are_the_same_bytes_in_two_processes(scenario, result, tmp_path):
    """Those again in one process are in `test_cache.py`."""
    _, first = result
    out, seen = tmp_path / "two", []
    compare(
        scenario, ["no-divert", "safest"], flights=2, seed=4, jobs=2, out=out,
        progress=seen.append, figures=False,
    )  # fmt: skip
    assert (out / "results.parquet").read_bytes() == (first / "results.parquet").read_bytes()
    assert sum(seen) == 4, "progress counts flights"


def test_folder_holds_what_was_promised(result):
    summary, out = result
    table = pd.read_parquet(out / "results.parquet")
    assert len(table) == 4
    assert list(table["policy"]) == ["no-divert", "safest"] * 2
    assert {p.name for p in (out / "flights" / "safest").iterdir()} == {"00000", "00001"}
    for policy in ("no-divert", "safest"):
        for name in ("descent", "maps"):
            assert (out / "figures" / policy / f"{name}.png").stat().st_size > 20_000
    assert (out / "figures" / "comparison.png").exists()
    assert json.loads((out / "summary.json").read_text())["complete"]
    assert Scenario.load(out / "scenario.toml").name == "tiny"
    assert summary.complete
    assert 0.0 <= summary.safe_share <= summary.safe_share_at_heading <= 1.0


def test_interrupt_keeps_what_is_finished(scenario, tmp_path):
    out = tmp_path / "out"

    def stop(_: int) -> None:
        raise KeyboardInterrupt

    result = compare(
        scenario, ["no-divert", "safest"], flights=3, seed=1, out=out, progress=stop, figures=False
    )
    assert not result.complete
    assert list(result.without_flights) == ["safest"]
    assert len(pd.read_parquet(out / "results.parquet")) == 1
    assert not json.loads((out / "summary.json").read_text())["complete"]


def test_an_interrupt_before_the_first_flight_has_ended_is_no_error(
    scenario, tmp_path, monkeypatch
):
    def fly(*_):
        raise KeyboardInterrupt
        yield

    asked = {"flights": 1, "seed": 1, "out": tmp_path / "out"}
    monkeypatch.setattr(viz, "draw_flight", undrawn)
    with monkeypatch.context() as patched:
        patched.setattr(InlineEngine, "fly", fly)
        begun = compare(scenario, ["no-divert"], **asked)
    assert not begun.complete and begun.rows == [] and begun.failed == []
    gone_on = compare(scenario, ["no-divert"], **asked)
    assert gone_on.complete and len(gone_on.rows) == 1


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"policies": ["safets"]}, "--policies"),
        ({"policies": []}, "--policies"),
        ({"policies": ["safest", "safest"]}, "--policies"),
        ({"flights": 0}, "--flights"),
        ({"jobs": 0}, "--jobs"),
    ],
)
def test_bad_requests(scenario, tmp_path, change, field):
    request = {"policies": ["safest"], "flights": 1, "jobs": 1} | change
    with pytest.raises(InputError) as caught:
        compare(scenario, request.pop("policies"), seed=1, out=tmp_path / "o", **request)
    assert caught.value.field == field
    assert not (tmp_path / "o").exists()


def test_other_results_are_not_overwritten(scenario, tmp_path):
    (tmp_path / "precious.txt").write_text("keep")
    with pytest.raises(InputError, match="new or empty folder"):
        compare(scenario, ["safest"], flights=1, seed=1, out=tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["precious.txt"]


LAWS = ("apollo", "e-guidance", "zem-zev")


@pytest.fixture(scope="module")
def by_law(scenario, tmp_path_factory):
    out = tmp_path_factory.mktemp("laws") / "out"
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(viz, "draw_flight", undrawn)
        return compare(scenario, ["no-divert"], flights=2, seed=4, out=out, guidance=LAWS), out


def test_laws_are_compared_as_policies_are(scenario, by_law):
    result, out = by_law
    assert result.by_law
    assert [row["policy"] for row in result.shown] == list(LAWS) * 2
    assert {row["policy"] for row in result.rows} == {"no-divert"}
    assert set(result.seconds) == set(LAWS)
    assert {p.name for p in (out / "flights").iterdir()} == set(LAWS)
    assert (out / "figures" / "comparison.png").stat().st_size > 20_000
    spent = {(r["arm"], r["flight"]): r["propellant_kg"] for r in result.rows}
    for flight in range(2):
        # Two ways of writing one law fly the same; another does not.
        assert spent["zem-zev", flight] == pytest.approx(spent["e-guidance", flight], rel=1e-6)
        assert abs(spent["apollo", flight] - spent["e-guidance", flight]) > 0.1
    # Each meets the world, start and noise that it meets by itself.
    alone = compare(
        scenario.changed(guidance={"kind": "e-guidance"}), ["no-divert"], flights=2, seed=4
    )
    own = [row for row in result.rows if row["arm"] == "e-guidance"]
    assert [r["propellant_kg"] for r in own] == [r["propellant_kg"] for r in alone.rows]


def test_several_policies_and_laws_are_every_pair(scenario):
    seen = []
    result = compare(
        scenario, ["no-divert", "safest"], flights=1, seed=4, guidance=["apollo", "e-guidance"],
        progress=seen.append,
    )  # fmt: skip
    assert sum(seen) == 4, "progress counts flights"
    assert [row["policy"] for row in result.shown] == [
        "no-divert, apollo", "no-divert, e-guidance", "safest, apollo", "safest, e-guidance",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("laws", "said"),
    [(["apolo"], "--guidance"), (["apollo", "apollo"], "each guidance law only once")],
)
def test_laws_that_will_not_do_are_refused(scenario, laws, said):
    with pytest.raises(InputError, match=said):
        compare(scenario, ["no-divert"], flights=1, seed=1, guidance=laws)


def test_the_command_prints_a_row_a_law(tmp_path, scenario, by_law):
    from click.testing import CliRunner

    from lunarsim.cli import main

    scenario.save(tmp_path / "tiny.toml")
    # It asks for what has been flown there, or the folder would be refused.
    out = tmp_path / "out"
    shutil.copytree(by_law[1], out)
    laws = [word for law in LAWS for word in ("--guidance", law)]
    done = CliRunner().invoke(
        main,
        ["compare", str(tmp_path / "tiny.toml"), *laws, "--policies", "no-divert", "--seed", "4",
         "--flights", "2", "--jobs", "1", "--no-figures", "--out", str(out)],
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "Extra propellant" in done.output
    rows = [line for line in done.output.splitlines() if any(law in line for law in LAWS)]
    assert len(rows) == len(LAWS)
    assert ["±" in row for row in rows] == [False, True, True]
