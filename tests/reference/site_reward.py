"""The reward of choosing sites, one flight, written out plainly."""

from __future__ import annotations

import math


class PlainReward:
    """Terms of one flight from what can be read off it; shares no helper with the package."""

    def __init__(self, weights, lander, mass, p_here, p, seen):
        self.w, self.lander = weights, lander
        self.mass, self.hope = mass, self._hope(p_here)
        self.known, self.wrong = self._known(p, seen), 0

    def _hope(self, p_here):
        return 0.0 if math.isnan(p_here) else self.w.shaping * p_here

    @staticmethod
    def _known(p, seen):
        total, cells = 0.0, 0
        for row, mask in zip(p.tolist(), seen.tolist(), strict=True):
            for one, there in zip(row, mask, strict=True):
                total += 1.0 - 4.0 * one * (1.0 - one) if there else 0.0
                cells += 1
        return total / cells

    def step(self, invalid, ended, safe, touch, mass, p_here, p, seen):
        """Return the terms; `touch`: vertical, horizontal speed, tilt, slope, roughness or None."""
        w, v = self.w, self.lander
        told = dict.fromkeys(("touchdown", "invalid", "speed", "tilt", "hazard"), 0.0)
        told["propellant"] = w.propellant * (mass - self.mass) / v.propellant_mass
        if invalid:
            self.wrong += 1
            told["invalid"] = -w.invalid if self.wrong <= 10 else 0.0
        if ended:
            told["touchdown"] = w.safe if safe else w.unsafe
        if ended and safe:
            down, side, tilt, slope, rough = (abs(float(one)) for one in touch)
            told["speed"] = -w.speed * max(
                down / v.vertical_speed_limit, side / v.horizontal_speed_limit
            )
            told["tilt"] = -w.tilt * tilt / v.tilt_limit
            told["hazard"] = -w.hazard * max(slope / v.slope_limit, rough / v.roughness_limit)
        known, hope = self._known(p, seen), 0.0 if ended else self._hope(p_here)
        told["information"] = w.information * (known - self.known)
        told["shaping"] = hope - self.hope
        self.mass, self.known, self.hope = mass, known, hope
        return told
