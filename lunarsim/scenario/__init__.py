"""Read, check and change scenarios: one TOML file that defines a study."""

from lunarsim.scenario.scenario import Scenario

__all__ = ["Scenario"]
