"""The picture of the maps: what stands where, and how panels and words lie beside each other."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_rgba
from matplotlib.text import Annotation

from lunarsim.evaluation.flight_metrics import initial_aim_point
from lunarsim.evaluation.reach import decision_rows, estimate_at_row, reach_at_row
from lunarsim.grid import Grid
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.viz import maps
from lunarsim.viz.map_bounds import map_figure_bounds
from lunarsim.viz.maps import draw_reach
from lunarsim.viz.style import new_figure
from lunarsim.world import World
from lunarsim.world.terrain import Heightfield, Terrain
from lunarsim.world.truth import TerrainTruth
from tests.worlds import TINY_FLIGHT


@pytest.fixture(scope="module")
def flown():
    """Return a flight that diverts, its world and its truth."""
    scenario = Scenario.from_dict(TINY_FLIGHT).changed(rocks={"cover": 0.1})
    for seed in range(1, 9):
        simulation = Simulation(scenario, flight_seed(seed, 0), "safest")
        record = simulation.run()
        if record.decisions:
            break
    return record, simulation.world, simulation.truth


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """Return a function that draws and returns the figure."""
    kept = []
    monkeypatch.setattr(maps, "save", lambda figure, path: kept.append(figure))

    def draw(*what):
        maps.draw_maps(*what, tmp_path / "maps.png")
        kept[-1].canvas.draw()
        return kept[-1]

    return draw


def _panels(figure):
    return [axes for axes in figure.axes if axes.get_xlabel() == "East (m)"]


def _points(panel, marker):
    return [line for line in panel.lines if line.get_marker() == marker]


def test_sites_aim_and_diverts_stand_where_they_were_in_the_true_frame(flown, drawn):
    record = flown[0]
    panels = _panels(drawn(*flown))
    (sites,) = _points(panels[2], "o")
    east, north = record.map_error[:2]
    assert np.column_stack(sites.get_data()) == pytest.approx(
        record.candidates[:, :2] - [east, north]
    )
    t = record.trajectory
    for panel in panels:
        for cross in _points(panel, "x"):
            assert np.ravel(cross.get_data()) == pytest.approx(initial_aim_point(record))
        arrows = [text for text in panel.texts if isinstance(text, Annotation)]
        assert len(arrows) == len(record.decisions) > 0
        for arrow, decision in zip(arrows, record.decisions, strict=True):
            row = int(np.argmin(np.abs(t["time"] - decision["time"])))
            error = [t[f"estimated_{a}"][row] - t[f"position_{a}"][row] for a in "xy"]
            assert arrow.xyann == pytest.approx(np.asarray(decision["from"])[:2] - error)
            assert arrow.xy == pytest.approx(np.asarray(decision["to"])[:2] - error)


def test_returns_and_tracked_rocks_stand_in_the_true_frame(flown, drawn):
    """Also where the map is off: all of it is, together."""
    record = flown[0]
    (name, own), *_ = record.maps.items()
    rocks = {"x": np.array([3.0]), "y": np.array([-4.0]), "radius": np.array([0.5])}
    off = replace(own, tables=own.tables | {"rocks": rocks}, error=np.array([5.0, -7.0, 0.5]))
    moved = replace(record, maps={name: off})
    panel = _panels(drawn(moved, *flown[1:]))[3]
    scans, circles = panel.collections[:2]
    east, north, _ = moved.map_error
    assert (east, north) == (5.0, -7.0)
    assert np.asarray(scans.get_offsets()) == pytest.approx(record.scans[:, :2] - [east, north])
    extent = circles.get_paths()[0].get_extents()
    assert extent.get_points().mean(axis=0) == pytest.approx([-2.0, 3.0])


def test_the_legend_shows_marks_as_they_are_drawn(flown, drawn):
    figure = drawn(*flown)
    (legend,) = figure.legends
    handles = {
        text.get_text(): handle
        for text, handle in zip(legend.get_texts(), legend.legend_handles, strict=True)
    }
    panels = _panels(figure)
    (sites,) = _points(panels[2], "o")
    shown = handles["candidate site"]
    for get in ("get_marker", "get_markerfacecolor", "get_markeredgecolor", "get_markersize"):
        assert getattr(shown, get)() == getattr(sites, get)()
    arrow = next(text for text in panels[0].texts if isinstance(text, Annotation))
    assert to_rgba(handles["divert"].get_color()) == arrow.arrow_patch.get_edgecolor()
    path = panels[0].lines[0]
    assert handles["ground track"].get_color() == path.get_color()


def test_safe_terrain_has_the_colour_that_the_legend_names(flown, drawn):
    record, world, whole = flown
    truth = whole.within(map_figure_bounds(record, world), 400)
    figure = drawn(*flown)
    handles = {handle.get_label(): handle for handle in figure.legends[0].legend_handles}
    image = _panels(figure)[1].images[1]
    shown = image.to_rgba(image.get_array(), alpha=1.0)
    safe, seen = truth.safe, truth.observed
    for name, where in (
        ("truly safe at every heading", seen & safe),
        ("truly unsafe", seen & ~safe),
        ("edge of the terrain", ~seen),
    ):
        assert where.any()
        wanted = to_rgba(handles[name].get_facecolor())
        assert np.abs(shown[where] - wanted).max() < 0.01, name


def test_bars_lie_below_their_own_panels(flown, drawn):
    figure = drawn(*flown)
    panels = _panels(figure)
    bars = [axes for axes in figure.axes if axes not in panels]
    assert len(bars) == len(panels) == 4
    for bar, panel in zip(bars, panels, strict=True):
        inner, outer = bar.get_window_extent(), panel.get_window_extent()
        assert inner.y1 < outer.y0
        assert outer.x0 - 10.0 < inner.x0 and inner.x1 < outer.x1 + 10.0


def test_words_on_a_map_stay_within_their_panel_of_tall_terrain(flown, drawn):
    record, world, _ = flown
    grid = Grid(x0=-16.0, y0=-30.0, posting=0.5, rows=121, cols=65)
    tall = World(Terrain(Heightfield(grid, np.zeros(grid.shape, np.float32))), 1.622, world.light)
    (name, known), *_ = record.maps.items()
    m = known.hazard_map
    flat = replace(m, p_safe=np.full(m.grid.shape, np.float32(0.9)))
    said = replace(known, hazard_map=replace(flat, in_domain=np.zeros(m.grid.shape, bool)))
    told = replace(record, maps={name: said}, scans=record.scans[:0])
    lander = Scenario.from_toml(record.scenario).vehicle.make()
    figure = drawn(told, tall, TerrainTruth.of(tall, lander))
    panels = _panels(figure)
    boxes = [panel.get_window_extent() for panel in panels]
    assert np.ptp([box.height for box in boxes]) < 1.0
    assert np.ptp([box.y1 for box in boxes]) < 1.0
    (words,) = [text for text in panels[2].texts if "this map" in text.get_text()]
    assert "classifies all observed terrain safe" in words.get_text().replace("\n", " ")
    inner = words.get_bbox_patch().get_window_extent()
    assert boxes[2].x0 < inner.x0 and inner.x1 < boxes[2].x1
    room = figure.bbox.width / len(panels)
    assert all(panel.title.get_window_extent().width < room for panel in panels)


def test_outlines_of_reach_are_those_of_the_law(flown, drawn):
    """At the last decision less is in reach than at the first, and the outline parts the two."""
    record, world, truth = flown
    rows = decision_rows(record)
    t = record.trajectory
    decided = [d["time"] for d in record.decisions]
    assert t["time"][rows[0]] <= decided[0]
    assert t["time"][rows[1]] >= decided[-1]
    assert (t["phase"][[*rows]] == 0).all()
    wide = Grid.centred(record.sites[rows[1], :2], 2000.0, 40.0)
    first, last = (reach_at_row(record, row, wide).reachable for row in rows)
    assert 0 < last.sum() < first.sum() < first.size
    # What the lander flies to is in reach.
    for row in rows:
        assert reach_at_row(record, row, wide).at(record.sites[row, :2])
    here = estimate_at_row(record, rows[0])
    assert here.position[0] == t["estimated_x"][rows[0]]
    assert here.velocity[2] == t["estimated_velocity_z"][rows[0]]
    assert here.mass == t["estimated_mass"][rows[0]]
    figure = drawn(*flown)
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert sum("reachable at the" in word for word in words) == 2
    silent = replace(record, first_map=None)
    assert decision_rows(silent) is None
    words = [text.get_text() for text in drawn(silent, world, truth).legends[0].get_texts()]
    assert not any("in reach" in word for word in words)


def test_outlines_of_reach_part_what_is_in_reach_from_what_is_not(flown):
    record = flown[0]
    figure = new_figure(4.0, 4.0)
    panel = figure.subplots()
    error = record.map_error
    aside, up = record.sites[-1, :2] - error[:2]
    told = draw_reach(panel, record, (aside - 900.0, aside + 900.0, up - 900.0, up + 900.0))
    assert [line.get_linestyle() for line in told] == ["-", ":"]
    shares = [float(re.search(r": (\S+) %", line.get_label())[1]) for line in told]
    assert 0.0 < shares[1] < shares[0] < 100.0
    row = decision_rows(record)[0]
    outline = np.vstack(panel.collections[1].get_paths()[0].to_polygons())
    beyond = np.array([aside, up]) - outline
    beyond /= np.linalg.norm(beyond, axis=1, keepdims=True)
    grid = Grid.centred(record.sites[-1, :2], 4000.0, 4.0)
    cost = reach_at_row(record, row, grid)
    within = cost.at(outline + error[:2] + 60.0 * beyond)
    without = cost.at(outline + error[:2] - 60.0 * beyond)
    assert within.mean() > 0.9
    assert without.mean() < 0.1


def test_reach_is_reported_for_the_rows_that_decisions_fall_in(flown):
    """To the row: heights of the pads' foot above the site, after the first map."""
    record = flown[0]
    t, scenario = record.trajectory, Scenario.from_toml(record.scenario)
    height = t["estimated_z"] - t["site_z"] - scenario.vehicle.make().com_height
    first, last = decision_rows(record)
    assert np.all(np.diff(height[first : last + 1]) < 0.0)
    third = (last - first) // 3
    early, late = first + third, last - third
    bounds = {"first_altitude_m": float(height[early]) + 0.01,
              "last_altitude_m": float(height[late]) - 0.01}  # fmt: skip
    narrow = replace(record, scenario=scenario.changed(decisions=bounds).to_toml())
    assert decision_rows(narrow) == (early, late)
    mapped = replace(record.first_map, time=float(t["time"][early + 2]))
    assert decision_rows(replace(narrow, first_map=mapped)) == (early + 2, late)


def test_reach_is_surveyed_where_the_panel_is_and_on_the_mapped_terrain(flown, monkeypatch):
    record, asked = flown[0], []
    record = replace(record, maps={
        name: replace(kept, error=np.array([3.0, -2.0, 0.0])) for name, kept in record.maps.items()
    })  # fmt: skip

    def spied(flight, row, grid):
        asked.append(grid)
        return reach_at_row(flight, row, grid)

    monkeypatch.setattr(maps, "reach_at_row", spied)
    draw_reach(new_figure(4.0, 4.0).subplots(), record, (-90.0, 30.0, -20.0, 40.0))
    assert len(asked) == 2
    for grid in asked:
        assert grid.centre == pytest.approx((-27.0, 8.0))
        assert (grid.cols, grid.rows) == (100, 50)
        assert grid.posting == pytest.approx(1.2)
    # Higher ground at the site is told apart from the level of the site elsewhere.
    row = decision_rows(record)[0]
    lifted = replace(record.hazard_map, elevation=record.hazard_map.elevation + np.float32(30.0))
    raised = replace(record, maps={
        name: replace(kept, hazard_map=lifted) for name, kept in record.maps.items()
    })  # fmt: skip
    grid = Grid.centred(record.sites[row, :2], 4.0, 1.0)
    costs = [reach_at_row(flight, row, grid).propellant for flight in (record, raised)]
    assert np.all(np.abs(costs[0] - costs[1]) > 0.05)


@pytest.fixture(scope="module")
def wide(flown):
    """Return a flight, and its world as the middle of one ten times as wide."""
    record, world, _ = flown
    relief = world.terrain.relief
    west, east, _, _ = world.terrain.bounds
    width = 10.0 * (east - west)
    grid = Grid.centred(relief.grid.centre, width, relief.grid.posting)
    z = np.resize(relief.z, grid.shape)
    return record, World(Terrain(Heightfield(grid, z)), 1.622, world.light)


def test_of_a_wide_world_the_window_about_map_sites_and_touchdown_is_drawn(wide, drawn):
    record, world = wide
    lander = Scenario.from_toml(record.scenario).vehicle.make()
    truth = TerrainTruth.of(world, lander)
    west, east, south, north = map_figure_bounds(record, world)
    assert max(east - west, north - south) < 0.25 * (world.terrain.bounds[1] * 2.0)
    for panel in _panels(drawn(record, world, truth)):
        assert (*panel.get_xlim(), *panel.get_ylim()) == pytest.approx((west, east, south, north))
        for image in panel.images[:1]:
            x0, x1, y0, y1 = image.get_extent()
            assert x0 <= west and east <= x1 and y0 <= south and north <= y1
    points = [initial_aim_point(record), record.positions[-1, :2], *record.candidates[:, :2]]
    x, y = np.array(points).T
    assert west < x.min() and x.max() < east and south < y.min() and y.max() < north


def test_a_flight_without_a_map_shows_where_it_came_down(wide):
    record, world = wide
    bounds = map_figure_bounds(replace(record, maps={}), world)
    end = record.positions[-1, :2]
    assert bounds[0] < end[0] - 40.0 and end[0] + 40.0 < bounds[1]
    assert max(bounds[1] - bounds[0], bounds[3] - bounds[2]) < 300.0
