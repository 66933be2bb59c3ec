"""What a comparison's figure shows, against counts and means by hand."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.scenario import Scenario
from lunarsim.viz import draw_comparison

MAPS = {
    "a": {"map_true_safe": 30, "map_false_safe": 10, "map_false_unsafe": 20},
    "b": {"map_true_safe": 10, "map_false_safe": 0, "map_false_unsafe": 30},
}
ROWS = [
    {
        "policy": policy, "flight": flight, "safe": not failed, "failure_causes": failed,
        "aborted": False,
        "propellant_kg": 40.0 + flight * (1.0 if policy == "a" else 3.0),
        "divert_m": 1.0, "vertical_speed_m_s": 2.0,
        "horizontal_speed_m_s": 0.1, "tilt_deg": tilt, "safe_site_in_reach": True, **MAPS[policy],
    }
    for policy, flight, failed, tilt in (
        ("a", 0, "", 1.0), ("a", 1, "slope,belly", 2.0), ("a", 2, "belly", 3.0),
        ("b", 0, "roughness,slope", 2.0), ("b", 1, "", 2.0), ("b", 2, "", 5.0),
    )
]  # fmt: skip


@pytest.fixture(scope="module")
def panels(tmp_path_factory):
    """Return the panels of the figure by a word of their label."""
    kept = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("lunarsim.viz.comparison.save", lambda figure, path: kept.append(figure))
        draw_comparison(ROWS, Scenario.from_dict({}), tmp_path_factory.mktemp("c") / "c.png")
    (figure,) = kept
    return {ax.get_xlabel().split(",")[0].split(" (")[0].split("\n")[0]: ax for ax in figure.axes}


def bars(ax, label):
    """Return width by place of the bars of one label."""
    (found,) = [c for c in ax.containers if c.get_label() == label]
    return {round(bar.get_y() + 0.5 * bar.get_height()): bar.get_width() for bar in found}


def test_flights_count_with_their_first_cause(panels):
    ax = panels["Failed flights"]
    assert bars(ax, "slope") == {0: 1.0, 1: 0.0}
    assert bars(ax, "belly") == {0: 1.0, 1: 0.0}
    assert bars(ax, "roughness") == {0: 0.0, 1: 1.0}


def test_better_is_safe_here_alone_and_worse_safe_with_the_first_alone(panels):
    ax = panels["Flights with another outcome"]
    widths = {(round(p.get_y() + 0.5 * p.get_height()), p.get_width()) for p in ax.patches}
    assert widths == {(0, 0.0), (1, 2.0), (1, -1.0)}
    assert [t.get_text().strip() for t in ax.texts] == ["2 better, 1 worse"]


def test_the_limit_of_the_tilt_stands_where_the_lander_has_it(panels):
    (line,) = [x for x in panels["Tilt at touchdown"].lines if x.get_label() == "limit"]
    assert line.get_xdata()[0] == pytest.approx(6.0)


def test_the_difference_of_the_tilt_is_a_mean_with_its_interval(panels):
    ax = panels["Paired difference from a"]
    # Of 1, 0 and 2 deg: the mean is 1, the standard error 1 / sqrt(3), Student's t 4.3027.
    half = 4.30265 / np.sqrt(3.0)
    thick = [x.get_xdata() for x in ax.lines if x.get_linewidth() == 3.0]
    assert thick[-1] * 6.0 == pytest.approx([1.0 - half, 1.0 + half], abs=1e-3)
    thin = [x.get_xdata() for x in ax.lines if x.get_linewidth() == 0.8 and len(x.get_xdata()) == 2]
    assert any(np.allclose(np.array(x) * 6.0, [0.0, 2.0]) for x in thin)


def test_the_difference_of_propellant_is_a_mean_with_its_interval(panels):
    ax = panels["Propellant"]
    # Of 0, 2 and 4 kg: the mean is 2, the standard error 2 / sqrt(3).
    half = 4.30265 * 2.0 / np.sqrt(3.0)
    (thick,) = [x.get_xdata() for x in ax.lines if x.get_linewidth() == 3.0]
    assert thick == pytest.approx([2.0 - half, 2.0 + half], abs=1e-3)
    assert "(kg)" in ax.get_xlabel()


def test_speeds_of_each_touchdown_are_drawn_with_both_limits(panels):
    ax = panels["Lateral speed at contact"]
    lander = Scenario.from_dict({}).true_lander()
    lines = [x for x in ax.lines if x.get_linestyle() == "--"]
    assert lines[0].get_xdata() == pytest.approx([lander.horizontal_speed_limit] * 2)
    assert lines[1].get_ydata() == pytest.approx([lander.vertical_speed_limit] * 2)
    points = {m: sum(len(x.get_xdata()) for x in ax.lines if x.get_marker() == m) for m in "ox"}
    assert points == {"o": 3, "x": 3}


def test_precision_and_recall_are_where_their_names_say(panels):
    ax = panels["Map precision and recall"]
    found = [(x.get_marker(), float(x.get_xdata()[0]), x.get_label()) for x in ax.lines]
    assert [x[:2] for x in found] == [("o", 0.75), ("D", 0.6), ("o", 1.0), ("D", 0.25)]
    assert [x[2] for x in found[:2]] == ["precision", "recall"]
