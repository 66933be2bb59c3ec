from __future__ import annotations

import pytest

from lunarsim.errors import InputError
from lunarsim.onboard.perception.detection_rates import DetectionRates


def test_rates_are_cut_lines():
    rates = DetectionRates((2.0, -0.5, 0.05), (0.2, -0.1, 0.01))
    assert rates.false_negative([0.0, 2.0, 3.0, 100.0]) == pytest.approx([1.0, 1.0, 0.5, 0.05])
    assert rates.false_positive([0.0, 1.0, 5.0]) == pytest.approx([0.2, 0.1, 0.01])
    assert rates.min_q == pytest.approx(2.0)
    with pytest.raises(InputError, match=r"rates\.missed"):
        DetectionRates((1.0, 0.3, 0.1))


def test_edges_are_wider_by_the_root_of_squares_and_never_narrower():
    rates = DetectionRates(blur=0.5)
    assert rates.relative_edge_width(0.5) == rates.relative_edge_width(0.0) == 1.0
    assert rates.relative_edge_width(1.2) == pytest.approx(
        ((1.44 + 1.0 / 12.0) / (0.25 + 1.0 / 12.0)) ** 0.5
    )
    for blur in (-0.1, float("nan"), float("inf")):
        with pytest.raises(InputError, match=r"rates\.blur"):
            DetectionRates(blur=blur)
