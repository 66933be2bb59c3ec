"""Evaluate hazard maps, probabilities, flights and campaigns against the truth."""
