"""What crosses the wall between plant and onboard computer: measurements, commands, briefing."""
