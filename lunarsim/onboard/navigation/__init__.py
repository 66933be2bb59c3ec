"""Onboard navigation: estimate the lander's state and its covariance."""

from lunarsim.onboard.navigation.estimate import Estimate, Navigation

__all__ = ["Estimate", "Navigation"]
