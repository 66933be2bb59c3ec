"""Train an agent of Guidance-v1 with the defaults of Stable-Baselines3, and save it.

    python scenarios/learning/minimal_ppo.py
    lunarsim evaluate Guidance-v1 --agent minimal_ppo.zip --trust-pickle --agent apollo

It needs the extra `rl` and about six minutes on one core.
"""

import sys

import gymnasium

from lunarsim_envs.training.optional_packages import imports_of_extra

with imports_of_extra("rl"):
    import torch
    from stable_baselines3 import PPO

    from lunarsim_envs.training.sb3_vec_env import Sb3VecEnv

if __name__ == "__main__":
    steps = int(sys.argv[1]) if len(sys.argv) > 1 else 3_000_000
    torch.set_num_threads(1)
    batch = gymnasium.make_vec(
        "lunarsim_envs:lunarsim/Guidance-v1", num_envs=64,
        vectorization_mode="vector_entry_point", autoreset_mode="SameStep",
    )  # fmt: skip
    env = Sb3VecEnv(batch)
    env.seed(0)
    model = PPO("MlpPolicy", env, n_steps=128, batch_size=512, seed=0, verbose=1, device="cpu")
    model.learn(steps, log_interval=50)
    model.save("minimal_ppo.zip")
