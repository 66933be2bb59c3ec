"""Retargeting policies: keep the site, or fly to another.

A policy sees only what an onboard computer would; one that is allowed the truth says so in its
name and lives with the loop.
"""

from lunarsim.onboard.policies.contract import (
    Candidates,
    Decision,
    Observation,
    RetargetingPolicy,
)

__all__ = ["Candidates", "Decision", "Observation", "RetargetingPolicy"]
