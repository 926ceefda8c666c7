"""Step eight gymnasium environments with random actions, in one process and in eight processes.

It needs `pip install gymnasium`. Start with your own environment in the place of HoldTheCube.
"""

from time import perf_counter

from environment import HoldTheCube  # beside this file; exits if gymnasium is missing
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv

COUNT, STEPS = 8, 200

if __name__ == "__main__":  # a process that starts anew imports this file
    for kind in (SyncVectorEnv, AsyncVectorEnv):
        environments = kind([HoldTheCube] * COUNT)
        environments.reset(seed=1)
        environments.action_space.seed(1)
        total, started = 0.0, perf_counter()
        for _ in range(STEPS):
            actions = environments.action_space.sample()
            states, rewards, terminated, truncated, _ = environments.step(actions)
            total += rewards.sum()
        speed = COUNT * STEPS / (perf_counter() - started)
        distance = -total / (COUNT * STEPS)
        print(f"{kind.__name__}: {speed:,.0f} steps per second, mean distance {distance:.3f} m")
        environments.close()
