"""Agents flown over the same episodes and compared."""
