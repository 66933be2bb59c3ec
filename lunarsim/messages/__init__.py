"""Data exchanged between plant and onboard computer: measurements, commands, briefing."""
