"""Modules of `scripts/golden.py`: golden cases, digests and renamed results."""
