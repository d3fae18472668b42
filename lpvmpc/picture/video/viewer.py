"""A run live or again, in MuJoCo's interactive viewer."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterable
from functools import partial
from typing import Any

import glfw
import mujoco
from mujoco import viewer

from lpvmpc.errors import RenderError
from lpvmpc.picture.video import scenery
from lpvmpc.picture.video.render import Motion
from lpvmpc.picture.video.stage import add, draw_user
from lpvmpc.plant.plant import Plant
from lpvmpc.road.path import Path
from lpvmpc.traffic.users import Traffic
from lpvmpc.traffic.watch import Pose, poses
from lpvmpc.units import Array

FPS = 60
"""Pictures per second of a replay."""


class Window:
    """MuJoCo's interactive viewer on the scenery of a road."""

    def __init__(self, road: Path, instead: str, cones: Any = ()):
        """Args: the road, a sentence on what works without a window, places of cones (n, 2)."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", glfw.GLFWError)  # said in our own words instead
            if not glfw.init():
                raise RenderError(f"No window can be opened on this display; {instead}")
        self.scenery = scenery.build(road, width=1280, height=720, cones=cones)
        self.data = mujoco.MjData(self.scenery.model)
        self.window = viewer.launch_passive(
            self.scenery.model, self.data, show_left_ui=False, show_right_ui=False
        )
        self.window.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
        self.window.cam.trackbodyid = self.scenery.model.body("chassis").id
        self.window.cam.distance, self.window.cam.elevation = 9.0, -18.0

    def is_open(self) -> bool:
        """Whether nobody has closed it."""
        return bool(self.window.is_running())

    def show(
        self, qpos: Array, x: float, y: float, psi: float, others: Iterable[Pose] = ()
    ) -> None:
        """Show one instant.

        Args:
            qpos: Generalised coordinates of the car, shape (nq,).
            x: Its centre of mass [m].
            y: The same [m].
            psi: Its heading [rad].
            others: The other road users.
        """
        with self.window.lock():
            draw_users(self.window.user_scn, others)
            self.data.qpos[:] = qpos
            self.scenery.place(self.data, x, y, psi, sight=500.0)
            mujoco.mj_kinematics(self.scenery.model, self.data)
            mujoco.mj_camlight(self.scenery.model, self.data)
        self.window.sync()

    def close(self) -> None:
        """Close it."""
        self.window.close()


def draw_users(scene: mujoco.MjvScene, others: Iterable[Pose]) -> None:
    """Put other road users, and nothing else, into the scene that a viewer draws besides."""
    scene.ngeom = 0
    for user, x, y, psi in others:
        draw_user(partial(add, scene), user, x, y, psi)


class Viewer:
    """A run live, not faster than real time.

    It shows a copy: nothing done in its window reaches the car. When the window is closed the run
    goes on at full speed.
    """

    def __init__(self, plant: Plant, road: Path, traffic: Traffic | None = None):
        """Args: the plant that is driven, what it drives on, and who else does."""
        self.plant, self.traffic = plant, traffic
        self.window = Window(road, "--render makes a video without one.")
        self.start: float | None = None

    def show(self) -> None:
        """Show the plant as it is now, and wait for the clock."""
        if not self.window.is_open():
            return
        state = self.plant.state
        others = [] if self.traffic is None else poses(self.traffic, self.plant.time)
        self.window.show(self.plant.qpos, state.x, state.y, state.psi, others)
        if self.start is None:
            self.start = time.monotonic()
        time.sleep(max(0.0, self.plant.time - (time.monotonic() - self.start)))

    def close(self) -> None:
        """Close the window."""
        self.window.close()


def replay(log: Any, speed: float = 1.0) -> None:
    """Show a run from its log, again and again, until its window is closed.

    Args:
        log: Log of `simulate`, or of `read_run`, with two rows or more.
        speed: Factor of real time.

    Raises:
        RenderError: No window can be opened here, or nothing moves.
    """
    motion = Motion(log, FPS / speed)
    road = log.road or log.scenario.path
    window = Window(road, "`lpvmpc view --html` makes a page.", log.scenario.cones)
    users = log.meta.get("traffic", [])
    try:
        while window.is_open():
            start = time.monotonic()
            for k in range(len(motion)):
                if not window.is_open():
                    break
                now = motion.at(k)
                others = [
                    (user, now[f"user{i}_x_m"], now[f"user{i}_y_m"], now[f"user{i}_psi_rad"])
                    for i, user in enumerate(users)
                ]
                window.show(now["qpos"], now["x_m"], now["y_m"], now["psi_rad"], others)
                time.sleep(max(0.0, k / FPS - (time.monotonic() - start)))
    finally:
        window.close()
