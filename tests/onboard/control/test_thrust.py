from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from lunarsim.models.lander import Lander
from lunarsim.onboard.control.thrust import thrust_to_command


@given(arrays(np.float64, 3, elements=st.floats(-20.0, 20.0)), st.floats(1100.0, 1500.0))
def test_commands_respect_thrust_and_tilt(acceleration, mass):
    lander = Lander()
    tilt = np.deg2rad(40.0)
    command = thrust_to_command(acceleration, mass, lander, 0.3, tilt)
    assert lander.thrust_min <= command.thrust <= lander.thrust_max
    x, y, z, w = command.attitude
    assert 1.0 - 2.0 * (x * x + y * y) >= np.cos(tilt) - 1e-9


def test_vertical_thrust_comes_first():
    lander = Lander()
    most = lander.thrust_max / 1500.0
    command = thrust_to_command(np.array([5.0, 0.0, 0.95 * most]), 1500.0, lander, 0.0, 1.0)
    assert command.thrust == pytest.approx(lander.thrust_max)
    x, y, _, _ = command.attitude
    assert 1.0 - 2.0 * (x * x + y * y) == pytest.approx(0.95, abs=1e-9)
