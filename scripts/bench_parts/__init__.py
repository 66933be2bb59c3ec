"""Benchmarks of `scripts/bench.py`, one function each."""
