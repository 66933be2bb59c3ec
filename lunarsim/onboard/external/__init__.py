"""External flight software in place of parts of the onboard computer."""
