"""Scenarios: one TOML file that fixes a study, checked part by part and as a whole."""

from lunarsim.scenario.scenario import Scenario

__all__ = ["Scenario"]
