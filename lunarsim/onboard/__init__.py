"""Onboard software: measurements in, commands out, no access to the true state."""
