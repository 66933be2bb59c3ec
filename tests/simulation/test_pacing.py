"""Flights at wall-clock rate: time that passes, and cycles that are late."""

from __future__ import annotations

import time

from lunarsim.simulation.pacing import Pacer


def test_cycles_take_their_share_of_wall_clock_time():
    pacer = Pacer(rate=2.0, cycle=0.04)
    pacer.wait()
    start = time.perf_counter()
    for _ in range(25):
        pacer.wait()
    spent = time.perf_counter() - start
    assert 25 * 0.02 - 0.02 <= spent < 2.0
    assert pacer.cycles == 25
    assert "pace 2: 25 control cycles of 40 ms" in str(pacer)


def test_late_cycles_are_counted_and_not_made_up_for():
    pacer = Pacer(rate=1.0, cycle=0.02)
    pacer.wait()
    start = time.perf_counter()
    for n in range(6):
        if n in (1, 4):
            time.sleep(0.1)
        pacer.wait()
    assert time.perf_counter() - start >= 2 * 0.1 + 4 * 0.02 - 0.01
    assert pacer.overruns >= 2
    assert pacer.longest >= 0.1
    assert pacer.total < 6 * 0.2 + 1.0
    assert "overruns" in str(pacer)


def test_flight_without_a_cycle_has_no_statistics():
    assert str(Pacer(1.0, 0.1)) == "pace: no control cycle"
