"""Messages between plant and computer: measurements, commands, briefing."""
