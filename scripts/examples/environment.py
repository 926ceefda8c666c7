"""A gymnasium environment: hold a floating cube in position by pushing it.

It needs `pip install gymnasium`. Only the scene's file describes the water; importing sim registers
the plugin. Any number of environments can exist at once.
"""

import sys
from pathlib import Path

import mujoco
import numpy as np

import sim  # noqa: F401  registers the plugin

try:
    import gymnasium
except ImportError:
    print("gymnasium is not installed; run: pip install gymnasium")
    sys.exit()

CUBE = Path(__file__).resolve().parents[2] / "models" / "cube.xml"


class HoldTheCube(gymnasium.Env):
    """Action: force along x and y [N]. Observation: qpos (7,) and qvel (6,). Each episode starts at
    a random time of the sea."""

    action_space = gymnasium.spaces.Box(-500.0, 500.0, (2,), np.float64)
    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (13,), np.float64)

    def __init__(self) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(CUBE))
        self.data = mujoco.MjData(self.model)
        self.cube = self.model.body("cube").id

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        self.data.time = self.np_random.uniform(0.0, 60.0)
        return self._observed(), {}

    def step(self, action):
        self.data.xfrc_applied[self.cube, :2] = action
        mujoco.mj_step(self.model, self.data, nstep=10)
        far = float(np.linalg.norm(self.data.qpos[:2]))
        return self._observed(), -far, far > 20.0, False, {}

    def _observed(self) -> np.ndarray:
        return np.concatenate([self.data.qpos, self.data.qvel])


if __name__ == "__main__":
    environment = gymnasium.wrappers.TimeLimit(HoldTheCube(), max_episode_steps=200)
    for episode in range(3):
        state, _ = environment.reset(seed=episode)
        total, is_over = 0.0, False
        while not is_over:
            push = np.clip(-400.0 * state[:2] - 300.0 * state[7:9], -500.0, 500.0)
            state, reward, terminated, truncated, _ = environment.step(push)
            total, is_over = total + reward, terminated or truncated
        print(f"episode {episode}: mean distance {-total / 200:.3f} m")
