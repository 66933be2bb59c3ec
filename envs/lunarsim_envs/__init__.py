"""Gymnasium environments for lunar landing, based on lunarsim.

Importing this package registers the environments. The prefix in
``gymnasium.make("lunarsim_envs:lunarsim/Retarget-v1")`` imports it automatically.
"""

import gymnasium

gymnasium.register(
    id="lunarsim/Retarget-v1",
    entry_point="lunarsim_envs.retarget:RetargetEnv",
    vector_entry_point="lunarsim_envs.retarget_vector:RetargetVectorEnv",
    reward_threshold=0.5,
)
for _level in ("Guidance", "Control"):
    gymnasium.register(
        id=f"lunarsim/{_level}-v1",
        entry_point=f"lunarsim_envs.descent.env:{_level}Env",
        vector_entry_point=f"lunarsim_envs.descent.env:{_level}VectorEnv",
        reward_threshold=11.0,
    )
