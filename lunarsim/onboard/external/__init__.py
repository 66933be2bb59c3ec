"""External flight software: a library or a process in place of parts of the onboard computer."""
