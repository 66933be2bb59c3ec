"""The end of a phase of flight."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.onboard.guidance.contract import PhaseEnd


def test_ends_are_in_the_frame_in_which_control_lives():
    assert PhaseEnd(np.zeros(3), frame="local").frame == "local"
    with pytest.raises(InputError, match=r"end\.frame"):
        PhaseEnd(np.zeros(3), frame="site")
