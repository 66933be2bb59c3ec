from __future__ import annotations

import numpy as np
import pytest
from lunarsim.simulation.build import relief_of

from lunarsim.scenario import Scenario


@pytest.mark.parametrize("preset", ["mare", "highland", "polar"])
def test_presets_fill_what_is_left_out(preset):
    scenario = Scenario.from_dict({"terrain": {"preset": preset, "size_m": 100.0, "hurst": 0.5}})
    assert scenario.terrain.hurst == 0.5
    assert scenario.terrain.crater_density == 0.079
    cratered = relief_of(scenario.terrain)
    bare = relief_of(scenario.terrain.model_copy(update={"crater_density": 0.0}))
    step = np.diff(bare.z.astype(float)[::4, ::4]) / 1.0
    assert np.degrees(np.arctan(np.sqrt(2.0 * np.mean(step**2)))) == pytest.approx(
        scenario.terrain.rms_slope_deg, rel=0.25
    )
    assert np.std(cratered.z - bare.z) > 0.02
