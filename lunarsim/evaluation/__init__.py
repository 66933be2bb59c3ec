"""Evaluation of hazard maps, probabilities, flights and campaigns against the truth."""
