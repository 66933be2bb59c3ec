"""Lander, gravity and sensor models known to plant and onboard computer."""
