"""Evaluate and compare agents on identical episodes."""
