"""Parts of `scripts/mutants.py`: faults, trials of faults, and known equivalent faults."""
