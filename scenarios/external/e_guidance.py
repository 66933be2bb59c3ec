"""E-guidance of the approach: a guidance law in Python, in another process.

    lunarsim fly golombek --set guidance.kind=process --set guidance.path=e_guidance.py \
        --allow-program e_guidance.py

e_guidance.c is the same law in C; its results are equal to the last bit.
"""

from __future__ import annotations

from typing import Any

from lunarsim.interface import serve

MIN_TIME_TO_GO = 1.5


class EGuidance:
    """Law of one flight."""

    def __init__(self, briefing: Any) -> None:
        self.gravity, self.lag = float(briefing.get("gravity")), float(briefing.get("lag"))

    def step(self, given: Any, answer: Any) -> None:
        """Compute the thrust acceleration."""
        if given.get("phase") != 0:
            raise ValueError("this program has no terminal descent")
        estimate, end = given.parts["estimate"], given.parts["end"]
        left = max(float(given.get("time_to_go")) - self.lag, MIN_TIME_TO_GO)
        acceleration = []
        for k in range(3):
            velocity = float(estimate.get("velocity")[k])
            ahead = float(estimate.get("position")[k]) + self.lag * velocity
            final = float(end.get("velocity")[k])
            miss = float(end.get("position")[k]) - ahead - left * final
            acceleration.append((6.0 * miss / left + 4.0 * (final - velocity)) / left)
        acceleration[2] += self.gravity
        answer.set(acceleration=acceleration)


if __name__ == "__main__":
    serve(guidance=EGuidance)
