"""Retargeting policies: keep the landing site or divert to another one.

A policy receives only what is available onboard. A policy that uses the true state states this in its
name and belongs to the simulation package.
"""

from lunarsim.onboard.policies.contract import (
    Candidates,
    Decision,
    Observation,
    RetargetingPolicy,
)

__all__ = ["Candidates", "Decision", "Observation", "RetargetingPolicy"]
