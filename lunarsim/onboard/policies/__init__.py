"""Retargeting policies: keep the landing site or divert to another one.

A policy receives only what is available onboard. The name of a policy that uses the true state
states this; such a policy belongs to the simulation package.
"""

from lunarsim.onboard.policies.contract import (
    Candidates,
    Decision,
    Observation,
    RetargetingPolicy,
)

__all__ = ["Candidates", "Decision", "Observation", "RetargetingPolicy"]
