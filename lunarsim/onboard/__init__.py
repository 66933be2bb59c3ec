"""The onboard computer: measurements in, commands out; it never meets the world or a true state."""
