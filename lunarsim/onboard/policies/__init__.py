"""Retargeting policies: keep the site, or fly to another.

A policy sees only what an onboard computer would; one that is allowed the truth says so in its
name.
"""

from lunarsim.onboard.policies.contract import (
    Candidates,
    Decision,
    Observation,
    RetargetingPolicy,
)
from lunarsim.onboard.policies.library import POLICIES, make_policy

__all__ = [
    "POLICIES",
    "Candidates",
    "Decision",
    "Observation",
    "RetargetingPolicy",
    "make_policy",
]
