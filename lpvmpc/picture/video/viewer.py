"""A run live, in MuJoCo's interactive viewer."""

from __future__ import annotations

import time
import warnings

import glfw
import mujoco
from mujoco import viewer

from lpvmpc.errors import RenderError
from lpvmpc.picture.video import scenery
from lpvmpc.plant.plant import Plant
from lpvmpc.road.path import Path


class Viewer:
    """MuJoCo's interactive viewer on the scenery of the road, not faster than real time.

    It shows a copy: nothing done in its window reaches the car. When the window is closed the run
    goes on at full speed.
    """

    def __init__(self, plant: Plant, road: Path):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", glfw.GLFWError)  # said in our own words instead
            if not glfw.init():
                raise RenderError("--view cannot open a window on this display; --render makes a "
                                  "video without one.")
        self.plant = plant
        self.scenery = scenery.build(road, width=1280, height=720)
        self.data = mujoco.MjData(self.scenery.model)
        self.window = viewer.launch_passive(
            self.scenery.model, self.data, show_left_ui=False, show_right_ui=False
        )
        self.window.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
        self.window.cam.trackbodyid = self.scenery.model.body("chassis").id
        self.window.cam.distance, self.window.cam.elevation = 9.0, -18.0
        self.start: float | None = None

    def show(self) -> None:
        """Show the plant as it is now, and wait for the clock."""
        if not self.window.is_running():
            return
        state = self.plant.state
        with self.window.lock():
            self.data.qpos[:] = self.plant.qpos
            self.scenery.place(self.data, state.x, state.y, state.psi, sight=500.0)
            mujoco.mj_kinematics(self.scenery.model, self.data)
            mujoco.mj_camlight(self.scenery.model, self.data)
        self.window.sync()
        if self.start is None:
            self.start = time.monotonic()
        time.sleep(max(0.0, self.plant.time - (time.monotonic() - self.start)))

    def close(self) -> None:
        """Close the window."""
        self.window.close()
