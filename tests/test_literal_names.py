"""Names, paths and messages are printed and drawn as they are, whatever characters they hold."""

from __future__ import annotations

import io
import re

import numpy as np
import pytest
import rasterio
from click.testing import CliRunner
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rasterio.transform import from_origin
from rich.table import Table

from lunarsim.campaign.report.figures import differences_plot
from lunarsim.cli import main
from lunarsim.console import plain_console, plain_progress
from lunarsim.evaluation.comparisons import Difference
from lunarsim.scenario import Scenario
from lunarsim.viz import draw_comparison
from lunarsim.viz.style import escape_dollars
from tests.worlds import ROOT

NAMES = [
    "dem[final]", "[/]", "mare [/low sun]", "[red]x[/red]", ":moon:", "[nan, nan]", "a\\[b]",
    "cost $5 and $6", "$\\frac{$", "<b>x</b>", "{task.total}", "100 %",
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_console_and_progress_print_names_as_they_are(name):
    console = plain_console(100)
    console.file = io.StringIO()
    table = Table("name", title=name)
    table.add_row(name)
    console.print(table)
    console.print(name)
    with plain_progress(console) as progress:
        progress.add_task(name, total=1)
    assert console.file.getvalue().count(name) == 4


def test_every_console_is_a_plain_one():
    made = re.compile(r"(?<![\w.])(Console|Progress|Markdown)\(|from rich import|from_markup")
    files = [f for top in ("lunarsim", "envs", "scenarios", "scripts") for f in
             (ROOT / top).rglob("*.py") if "rich" in f.read_text("utf-8")]  # fmt: skip
    assert len(files) > 20
    found = {f.relative_to(ROOT).as_posix() for f in files if made.search(f.read_text("utf-8"))}
    assert found == {"lunarsim/console.py"}


@pytest.mark.parametrize("path", ["dem[final].tif", "x[/y].tif", "[red]z.tif"])
def test_terrain_info_prints_the_path(tmp_path, monkeypatch, path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / path).parent.mkdir(exist_ok=True)
    z = np.add.outer(np.arange(8.0), np.arange(8.0)).astype(np.float32)
    with rasterio.open(
        path, "w", driver="GTiff", height=8, width=8, count=1, dtype="float32",
        crs="+proj=eqc +R=1737400 +units=m", transform=from_origin(-4, 4, 1, 1),
    ) as file:  # fmt: skip
        file.write(z, 1)
    done = CliRunner().invoke(main, ["terrain", "info", path])
    assert done.exit_code == 0, done.output
    assert path in done.output.splitlines()[0]


def _pixels(text, **options):
    figure = Figure(figsize=(4, 1))
    FigureCanvasAgg(figure).draw()
    figure.text(0.1, 0.5, text, **options)
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba()).copy()


@pytest.mark.parametrize("name", [*NAMES, "\\$x", "$", "a\\$b$c"])
def test_figures_show_dollar_signs(name):
    assert np.array_equal(_pixels(escape_dollars(name)), _pixels(name, parse_math=False))


def test_a_comparison_draws_any_names(tmp_path):
    maps = {"map_true_safe": 30, "map_false_safe": 10, "map_false_unsafe": 20}
    row = {
        "flight": 0, "safe": False, "failure_causes": "slope", "aborted": False,
        "propellant_kg": 40.0,
        "divert_m": 1.0, "vertical_speed_m_s": 2.0, "horizontal_speed_m_s": 0.1, "tilt_deg": 1.0,
        "safe_site_in_reach": True, **maps,
    }  # fmt: skip
    rows = [row | {"policy": name} for name in ("$\\frac{$a", "$\\frac{$b")]
    scenario = Scenario.from_dict({"name": "$\\nonsense$"})
    draw_comparison(rows, scenario, tmp_path / "c.png")
    assert (tmp_path / "c.png").stat().st_size > 0


def test_plots_of_a_report_show_tags_and_keep_the_names_that_the_page_compares():
    made = [Difference("a<b>", "c&d", 3, 0.0, -0.1, 0.1, 1.0, 1.0)]
    (trace,) = differences_plot(made)["data"]
    assert trace["y"] == ["c&amp;d − a&lt;b&gt;"]
    assert trace["arms"] == ["a<b>", "c&d"]
