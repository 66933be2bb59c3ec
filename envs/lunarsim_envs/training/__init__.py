"""What trains agents: native batches as Stable-Baselines3 takes them. Needs the extra ``rl``."""
