"""Sensor tasking: where steerable sensors point and when they measure."""

from lunarsim.onboard.tasking.contract import Situation, Tasking

__all__ = ["Situation", "Tasking"]
