"""Parts of `scripts/mutants.py`: faults, trials, known equivalent faults."""
