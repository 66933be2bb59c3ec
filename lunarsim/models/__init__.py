"""Parameters known to plant and onboard computer: lander, gravity and sensor models."""
