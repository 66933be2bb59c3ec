from __future__ import annotations

import numpy as np
import pytest

from lunarsim.evaluation.statistics import Proportion, summarise_policies


def test_wilson_interval():
    # Closed form of the score interval.
    n, k, z = 50, 45, 1.959963984540054
    centre = (k + z * z / 2) / (n + z * z)
    half = z / (n + z * z) * np.sqrt(k * (n - k) / n + z * z / 4)
    assert Proportion(k, n).interval == pytest.approx((centre - half, centre + half))
    assert Proportion(0, 0).interval == (0.0, 1.0)
    assert str(Proportion(1, 2)).startswith("0.500 [")


def test_summary_pools_cells():
    base = {
        "policy": "a", "safe": True, "aborted": False, "safe_site_in_reach": True,
        "propellant_kg": 1.0,
        "divert_m": 2.0, "vertical_speed_m_s": 2.0, "horizontal_speed_m_s": 0.1, "tilt_deg": 1.0,
    }  # fmt: skip
    rows = [
        base | {"map_true_safe": 90, "map_false_safe": 10, "map_false_unsafe": 10},
        base | {"map_true_safe": 0, "map_false_safe": 0, "map_false_unsafe": 80, "safe": False,
                "safe_site_in_reach": False},
    ]  # fmt: skip
    a = summarise_policies(rows)["a"]
    assert a["precision"] == pytest.approx(0.9)
    assert a["recall"] == pytest.approx(0.5)
    assert a["safe"].count == 1
    assert a["safe_in_reach"].total == 1
