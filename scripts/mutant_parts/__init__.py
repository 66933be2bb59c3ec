"""Parts of `scripts/mutants.py`: the faults, the trial of one fault, the known equivalents."""
