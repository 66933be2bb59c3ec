"""Train agents with Stable-Baselines3 and other methods; needs the extra ``rl``."""
