from __future__ import annotations

import numpy as np

from lunarsim.onboard.navigation.error_state import Outcome
from lunarsim.onboard.navigation.picture_watch import ImageInnovationMonitor, Remedy

GOOD = Outcome(200.0, 200, True, np.zeros(200))
REFUSED = Outcome(900.0, 200, False)


def watch(outcomes, kind="places", step=0.2):
    events = []
    pictures = ImageInnovationMonitor(events)
    remedies = [pictures.record(kind, step * k, outcome) for k, outcome in enumerate(outcomes)]
    return pictures, [r for r in remedies if r is not Remedy.NONE], [e.name for e in events]


def test_good_images_need_no_correction():
    rng = np.random.default_rng(1)
    nis = rng.chisquare(200, 500)
    pictures, remedies, events = watch([Outcome(v, 200, True, np.zeros(200)) for v in nis])
    assert remedies == [] and events == [] and not pictures.lost


def test_rejections_inflate_reset_lose_and_recover():
    pictures, remedies, events = watch([REFUSED] * 22)
    assert remedies == [Remedy.DOUBT, Remedy.RENEW, Remedy.RENEW]
    assert events == ["doubted", "renewed", "lost"]
    assert pictures.lost
    back, _, events = watch([REFUSED] * 22 + [GOOD] * 60)
    assert events == ["doubted", "renewed", "lost", "believed"]
    assert not back.lost


def test_innovations_that_are_too_large_are_doubted_though_they_are_taken():
    _, remedies, _ = watch([Outcome(500.0, 200, True, np.zeros(200))] * 10)
    assert remedies[0] is Remedy.DOUBT
    _, remedies, _ = watch([Outcome(250.0, 200, True, np.zeros(200))] * 10)
    assert remedies == []


def test_shadows_that_fall_elsewhere_are_lost_for_good():
    wrong = Outcome(400.0, 1, False)
    right = Outcome(0.5, 1, True, np.zeros(1))
    pictures, remedies, events = watch([wrong] * 6 + [right] * 60, "shadows", 0.5)
    assert events == ["lost"] and remedies == [Remedy.RENEW]
    assert pictures.lost


def test_few_rocks_give_no_evidence():
    _, remedies, events = watch([Outcome(np.nan, 0, False)] * 50)
    assert remedies == [] and events == []
