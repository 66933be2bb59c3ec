"""Campaigns from the command line, from the sweep to the report, with real flights."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from lunarsim.campaign import store
from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.results import load_results
from lunarsim.campaign.run import IntervalWidthRule
from lunarsim.campaign.run import run as fly
from lunarsim.cli import main
from lunarsim.evaluation.sequences import share_confidence_sequence
from lunarsim.scenario import Scenario
from tests.campaign.processes import write_part
from tests.campaign.surrogate import plan
from tests.worlds import TINY_FLIGHT

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")


def run(*words: object):
    return CliRunner().invoke(main, [str(word) for word in words])


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """Return the folder of a sweep over two policies and two heights of the Sun."""
    folder = tmp_path_factory.mktemp("sweep")
    Scenario.from_dict(TINY_FLIGHT).changed(rocks={"cover": 0.12}).save(folder / "tiny.toml")
    done = run(
        "sweep", folder / "tiny.toml", "--over", "policy=no-divert,safest", "--over",
        "sun.elevation_deg=5,20", "--flights", 2, "--jobs", 1, "--out", folder / "out",
        "--cache-size", 0,
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "complete: 8 new flights" in done.output
    return folder / "out"


def test_rows_of_a_sweep(swept):
    table = pd.read_parquet(swept / "results")
    assert list(table["id"]) == [f"{i}-{a}" for i in (0, 1) for a in range(4)]
    assert list(table["policy.kind"][:4]) == ["no-divert"] * 2 + ["safest"] * 2
    assert list(table["sun.elevation_deg"][:4]) == [5.0, 20.0] * 2
    # No camera: the Sun changes nothing, and the same worlds are met.
    for a, b in ((0, 1), (2, 3), (4, 5)):
        assert table["touchdown_x_m"][a] == table["touchdown_x_m"][b]
    assert table["safe_share"].nunique() == 2
    assert set(table["outcome"]) == {"flown"}


def test_status_and_export(swept, tmp_path):
    done = run("campaign", "status", swept)
    assert done.exit_code == 0, done.output
    assert "complete, 8 of 8 flights" in done.output and "flown: 8" in done.output
    for name in ("x.csv", "x.parquet"):
        out = tmp_path / name
        assert run("campaign", "export", swept, "--out", out, "--timing").exit_code == 0
        table = pd.read_csv(out) if name.endswith("csv") else pd.read_parquet(out)
        assert len(table) == 8 and (table["seconds"] > 0.0).all()
    assert run("campaign", "export", swept, "--out", tmp_path / "x.txt").exit_code == 2


def test_a_flight_is_flown_again_to_the_same_end(swept, tmp_path):
    done = run("replay", swept, "--flight", "1-2", "--out", tmp_path / "flight")
    assert done.exit_code == 0, done.output
    assert "identical to the recorded result" in done.output
    assert (tmp_path / "flight" / "flight.json").exists()
    for wrong in ("9-0", "1-4", "1", "a-b"):
        refused = run("replay", swept, "--flight", wrong)
        assert (
            refused.exit_code == 2
            and "with INDEX from 0 to 1 and ARM from 0 to 3" in refused.output
        )


def test_a_replay_that_ends_otherwise_says_so(swept, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(swept, copy)
    path = copy / "results" / "part-00000.parquet"
    table = pq.read_table(path)
    place = table.column_names.index("propellant_kg")
    column = table["propellant_kg"].to_pandas() + 1.0
    write_part(path, table.set_column(place, "propellant_kg", [column]))
    done = run("replay", copy, "--flight", "0-0")
    assert done.exit_code == 1
    assert re.search(r"propellant_kg: recorded [\d.]+, now [\d.]+", done.output)


def test_the_gate_distinguishes_worse_from_equal(swept, tmp_path):
    assert run("campaign", "diff", swept, swept).exit_code == 0
    short = run("campaign", "diff", swept, swept, "--require-equivalent", "--margin", "0.01")
    assert short.exit_code == 1 and "inconclusive" in short.output
    other = tmp_path / "other"
    fly(plan(), InlineEngine(), other)
    assert run("campaign", "diff", swept, other).exit_code == 2
    # The same flights, of which one arm lost fifteen that landed safe.
    worse = tmp_path / "worse"
    shutil.copytree(other, worse)
    path = worse / "results" / "part-00000.parquet"
    table = pq.read_table(path).to_pandas()
    lost = table.index[(table["arm"] == "arm 1") & table["safe"].astype(bool)][:15]
    table.loc[lost, "safe"] = False
    schema = pq.read_schema(path)
    write_part(path, pq.ParquetFile(path).read().from_pandas(table, schema))
    assert run("campaign", "diff", other, other).exit_code == 0
    gate = run("campaign", "diff", other, worse)
    assert gate.exit_code == 1, gate.output
    assert re.search(r"arm 1 .*worse", gate.output) and not re.search(r"arm 0 .*worse", gate.output)
    assert run("campaign", "diff", worse, other).exit_code == 0
    assert run("campaign", "diff", other, other, "--metric", "x").exit_code == 2


def test_the_report_is_one_file_without_network(swept, tmp_path):
    out = tmp_path / "r.html"
    done = run("campaign", "report", swept, "--out", out)
    assert done.exit_code == 0, done.output
    page = out.read_text()
    head = page.replace(page[page.index("<script>") : page.index("const plots")], "")
    assert not re.search(r"""(src|href)\s*=\s*["']https?:""", head)
    for words in ("Summary", "Wilson", "Paired differences", "Reliability of p_safe", "Timing",
                  "Touchdown points"):  # fmt: skip
        assert words in head
    assert run("campaign", "report", tmp_path, "--out", out).exit_code == 2
    assert run("campaign", "report", swept, "--out", tmp_path / "r.txt").exit_code == 2


def test_the_report_lists_flights_without_an_outcome_first(tmp_path):
    folder = tmp_path / "c"
    fly(plan(), InlineEngine(), folder)
    path = folder / "results" / "part-00000.parquet"
    table, schema = pq.read_table(path).to_pandas(), pq.read_schema(path)
    rows = table.index[table["arm"] == "arm 1"]
    table["safe"] = table["safe"].astype(object)
    table.loc[rows, "safe"] = False
    table.loc[rows[-1], ["safe", "outcome", "error"]] = [None, "error", "it failed"]
    write_part(path, pq.ParquetFile(path).read().from_pandas(table, schema))
    assert run("campaign", "report", folder, "--out", tmp_path / "r.html").exit_code == 0
    listed = re.findall(
        r'<tr data-arm="arm 1"><td><code>([\d-]+)</code>.*?<td class="text">([^<]*)</td></tr>',
        (tmp_path / "r.html").read_text(),
    )
    assert len(listed) > 1 and listed[0] == (table["id"][rows[-1]], "it failed")


def test_keys_without_effect_are_reported_before_anything_is_flown(tmp_path):
    # Neither a camera nor a star tracker.
    spec = tmp_path / "s.toml"
    spec.write_text(
        'scenario = "hard"\nflights = 1\n[factors]\n"sun.elevation_deg" = [20.0, 60.0]\n'
    )
    done = run("campaign", "plan", spec)
    assert done.exit_code == 0
    told = [line for line in done.stderr.splitlines() if line.startswith("warning: ")]
    assert len(told) == 1
    assert "arm '60'" in told[0] and "sun.elevation_deg = 60: no effect" in told[0]


def test_tables_of_the_report_in_markdown(swept, tmp_path):
    """Those of the page: a row an arm, a row a pair, as many cells as its head has."""
    out, page = tmp_path / "r.md", tmp_path / "r.html"
    assert run("campaign", "report", swept, "--out", out).exit_code == 0
    assert run("campaign", "report", swept, "--out", page).exit_code == 0
    summary, differences, *_ = re.findall(r"(?:^\|.*\n)+", out.read_text(), re.MULTILINE)
    arms = load_results(swept).arms
    assert len(summary.splitlines()) == 2 + len(arms)
    assert len(differences.splitlines()) == 2 + math.comb(len(arms), 2)
    assert len({line.count(" |") for line in summary.splitlines()}) == 1
    shares = re.findall(r"\d\.\d{3} (\[\d\.\d{3}, \d\.\d{3}\])", summary)
    assert len(shares) == len(arms) and all(share in page.read_text() for share in shares)
    assert re.search(r"\[[+-]\d\.\d{3}, [+-]\d\.\d{3}\]", differences)


@pytest.mark.parametrize("flights", [12, 200], ids=["to the end", "stopped"])
def test_intervals_of_a_campaign_that_was_watched_stand_it(tmp_path, flights):
    """Also of one that met its last flight first: it would have stopped, had it been narrow."""
    rule = IntervalWidthRule("safe", 0.5, 2)
    watched = replace(plan(flights=flights), identity={"stop": {"metric": "safe", "width": 0.5}})
    assert fly(watched, InlineEngine(), tmp_path / "c", rule=rule).state == (
        "complete" if flights == 12 else "stopped"
    )
    out = tmp_path / "r.html"
    assert run("campaign", "report", tmp_path / "c", "--out", out).exit_code == 0
    page = out.read_text()
    table = load_results(tmp_path / "c").table.to_pandas()
    for _, rows in table.groupby("arm"):
        low, high = share_confidence_sequence(int(rows["safe"].sum()), len(rows))
        assert f"[{low:.3f}, {high:.3f}]" in page
    assert "confidence sequence" in page


@pytest.mark.parametrize("lost", ["one arm", "all"])
def test_arms_without_an_outcome_are_reported_and_not_drawn(tmp_path, lost):
    """A policy that raises each time, say."""
    raises = [f"{i}-{arm}" for i in range(4) for arm in ((1,) if lost == "one arm" else (0, 1))]
    ran = fly(plan(flights=4, raises=raises), InlineEngine(), tmp_path / "c")
    assert ran.complete and ran.failed == len(raises)
    out = tmp_path / "r.html"
    done = run("campaign", "report", tmp_path / "c", "--out", out)
    assert done.exit_code == 0, done.output
    page = out.read_text()
    assert "ValueError: no flight 0-1" in page
    data = json.loads(re.search(r"const plots = (\[.*?\]);?\n", page)[1])
    drawn = {trace["arm"] for p in data if p["id"] == "shares" for trace in p["data"]}
    assert drawn == ({"arm 0"} if lost == "one arm" else set())
    assert run("campaign", "status", tmp_path / "c").exit_code == 0
    assert run("campaign", "diff", tmp_path / "c", tmp_path / "c").exit_code == 0


def test_texts_of_flights_do_not_become_part_of_the_page(tmp_path, monkeypatch):
    monkeypatch.setattr(store, "PART_ROWS", 20)
    fly(plan(raises=["0-0"]), InlineEngine(), tmp_path / "c")
    path = tmp_path / "c" / "results" / "part-00000.parquet"
    table = pq.read_table(path).to_pandas()
    table.loc[0, "error"] = "</script><b onclick='x'> *a* | [b](c) sun.elevation_deg <!--<script>"
    write_part(path, pq.read_table(path).from_pandas(table, pq.read_schema(path)))
    out = tmp_path / "r.html"
    assert run("campaign", "report", tmp_path / "c", "--out", out).exit_code == 0
    assert "<b onclick" not in out.read_text() and "<!--" not in out.read_text()
    assert run("campaign", "report", tmp_path / "c", "--out", tmp_path / "r.md").exit_code == 0
    tables = (tmp_path / "r.md").read_text()
    assert r"\</script>\<b onclick='x'> \*a\* \| [b]\(c) sun.elevation_deg \<!--" in tables


def drawn(page: Path, query: str, tmp_path: Path) -> tuple[str, str]:
    """Return what a browser made of a page, and what it had to say."""
    command = [
        str(CHROMIUM), "--headless=new", "--no-sandbox", "--disable-gpu", "--dump-dom",
        "--virtual-time-budget=8000", "--enable-logging=stderr",
        f"--user-data-dir={tmp_path / 'profile'}", f"file://{page}?{query}",
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    return done.stdout, done.stderr


@pytest.mark.slow
def test_a_browser_draws_the_report_and_filters_by_factor(swept, tmp_path):
    assert CHROMIUM is not None, "needs chromium: sudo apt-get install chromium"
    out = tmp_path / "r.html"
    assert run("campaign", "report", swept, "--out", out).exit_code == 0
    for theme in ("light", "dark"):
        page, said = drawn(out, f"theme={theme}", tmp_path)
        assert "CONSOLE" not in said, said
        assert int(re.search(r'data-drawn="(\d+)"', page)[1]) >= 7
        assert len(re.findall(r'<tr data-arm="[^"]*"><td>', page)) >= 4
    page, said = drawn(out, "policy.kind=safest", tmp_path)
    assert "CONSOLE" not in said, said
    summary = page[page.index('id="summary"') : page.index("</table>")]
    assert len(re.findall(r"<tr data-arm=[^>]*hidden", summary)) == 2
    assert len(re.findall(r"<tr data-arm=", summary)) == 4


def test_help_loads_nothing_heavy():
    code = (
        "import sys; from click.testing import CliRunner; from lunarsim.cli import main;"
        "CliRunner().invoke(main, ['campaign', '--help']);"
        "print([m for m in ('numpy', 'scipy', 'pyarrow', 'numba') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
