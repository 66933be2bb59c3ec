"""What judges: maps against the truth, probabilities against frequencies, flights and campaigns."""
