from __future__ import annotations

import numpy as np

from lunarsim.onboard.navigation.error_state import UpdateOutcome
from lunarsim.onboard.navigation.innovation_monitor import (
    ImageInnovationMonitor,
    RockCorrection,
)

GOOD = UpdateOutcome(200.0, 200, True, np.zeros(200))
REFUSED = UpdateOutcome(900.0, 200, False)


def watch(outcomes, kind="places", step=0.2):
    events = []
    pictures = ImageInnovationMonitor(events)
    remedies = [pictures.record(kind, step * k, outcome) for k, outcome in enumerate(outcomes)]
    return pictures, [r for r in remedies if r is not RockCorrection.NONE], [e.name for e in events]


def test_good_images_need_no_correction():
    rng = np.random.default_rng(1)
    nis = rng.chisquare(200, 500)
    pictures, remedies, events = watch([UpdateOutcome(v, 200, True, np.zeros(200)) for v in nis])
    assert remedies == [] and events == [] and not pictures.lost


def test_rejections_inflate_reset_lose_and_recover():
    pictures, remedies, events = watch([REFUSED] * 22)
    assert remedies == [RockCorrection.INFLATE, RockCorrection.RESET, RockCorrection.RESET]
    assert events == ["covariance-inflated", "rocks-reset", "lost"]
    assert pictures.lost
    back, _, events = watch([REFUSED] * 22 + [GOOD] * 60)
    assert events == ["covariance-inflated", "rocks-reset", "lost", "recovered"]
    assert not back.lost


def test_innovations_that_are_too_large_are_flagged_though_they_are_taken():
    _, remedies, _ = watch([UpdateOutcome(500.0, 200, True, np.zeros(200))] * 10)
    assert remedies[0] is RockCorrection.INFLATE
    _, remedies, _ = watch([UpdateOutcome(250.0, 200, True, np.zeros(200))] * 10)
    assert remedies == []


def test_shadows_that_fall_elsewhere_are_lost_for_good():
    wrong = UpdateOutcome(400.0, 1, False)
    right = UpdateOutcome(0.5, 1, True, np.zeros(1))
    pictures, remedies, events = watch([wrong] * 6 + [right] * 60, "shadows", 0.5)
    assert events == ["lost"] and remedies == [RockCorrection.RESET]
    assert pictures.lost


def test_few_rocks_give_no_evidence():
    _, remedies, events = watch([UpdateOutcome(np.nan, 0, False)] * 50)
    assert remedies == [] and events == []
