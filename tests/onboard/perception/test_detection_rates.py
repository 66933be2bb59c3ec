from __future__ import annotations

import pytest

from lunarsim.errors import InputError
from lunarsim.onboard.perception.detection_rates import DetectionRates


def test_rates_are_cut_lines():
    rates = DetectionRates((2.0, -0.5, 0.05), (0.2, -0.1, 0.01))
    assert rates.false_negative([0.0, 2.0, 3.0, 100.0]) == pytest.approx([1.0, 1.0, 0.5, 0.05])
    assert rates.false_positive([0.0, 1.0, 5.0]) == pytest.approx([0.2, 0.1, 0.01])
    assert rates.least_q == pytest.approx(2.0)
    with pytest.raises(InputError, match=r"rates\.missed"):
        DetectionRates((1.0, 0.3, 0.1))
