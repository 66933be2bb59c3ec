"""Train agents, with vector environments adapted to Stable-Baselines3; needs the extra ``rl``."""
