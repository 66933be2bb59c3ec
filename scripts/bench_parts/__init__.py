"""The parts of `scripts/bench.py`, one function each."""
