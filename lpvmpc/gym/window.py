"""A picture of one car on its road, behind and above it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import partial
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from lpvmpc.errors import RenderError
from lpvmpc.traffic.watch import Pose
from lpvmpc.units import Array

SIGHT = 250.0
"""How far the road is drawn [m]."""


class Window:
    """Draws a car; the scene of a road is made when the car is first there."""

    def __init__(self, width: int, height: int, show: bool) -> None:
        """Args: size [px], and whether in a window instead of an array."""
        self.size, self.show = (width, height), show
        self._road: int | None = None
        self._scenery: Any = None
        self._context: Any = None
        self._viewer: Any = None

    def draw(
        self, number: int, path: Any, qpos: Array, state: Array,
        others: Iterable[Pose] = (),
    ) -> npt.NDArray[np.uint8] | None:
        """Draw it.

        Args:
            number: Of the road.
            path: The road.
            qpos: Coordinates of the car, shape (17,).
            state: x, y, psi, ..., see `seeing`.
            others: The other road users.

        Raises:
            RenderError: No OpenGL, or no display for a window.
        """
        if self._road != number:
            self._open(path)
            self._road = number
        data, scenery = self._data, self._scenery
        data.qpos[:] = qpos
        scenery.place(data, state[0], state[1], state[2], SIGHT)
        mujoco.mj_forward(scenery.model, data)
        camera = self._camera
        camera.lookat[:] = state[0], state[1], 0.8
        camera.azimuth = math.degrees(state[2])
        if self._viewer is not None:
            with self._viewer.lock():
                self._viewer.cam.lookat[:], self._viewer.cam.azimuth = camera.lookat, camera.azimuth
                self._viewer.user_scn.ngeom = 0
                self._add_users(self._viewer.user_scn, others)
            self._viewer.sync()
            return None
        self._context.make_current()
        mujoco.mjv_updateScene(scenery.model, data, self._option, None, camera,
                               mujoco.mjtCatBit.mjCAT_ALL, self._scene)
        self._add_users(self._scene, others)
        mujoco.mjr_render(self._rect, self._scene, self._gl)
        mujoco.mjr_readPixels(self._pixels, None, self._rect, self._gl)
        return np.ascontiguousarray(self._pixels[::-1])  # OpenGL's first row is the lowest

    @staticmethod
    def _add_users(scene: Any, others: Iterable[Pose]) -> None:
        from lpvmpc.picture.video.stage import add, draw_user

        for user, x, y, psi in others:
            draw_user(partial(add, scene), user, x, y, psi)

    def _open(self, path: Any) -> None:
        from lpvmpc.picture.video import scenery, stage

        self.close()
        width, height = self.size
        self._scenery = scenery.build(path, width=width, height=height)
        model = self._scenery.model
        self._data = mujoco.MjData(model)
        self._camera = mujoco.MjvCamera()
        self._camera.distance, self._camera.elevation = 9.0, -15.0
        if self.show:
            try:
                from mujoco import viewer

                self._viewer = viewer.launch_passive(
                    model, self._data, show_left_ui=False, show_right_ui=False
                )
            except Exception as error:
                raise RenderError(f"render_mode 'human' needs a display: {error}") from error
            self._viewer.cam.distance, self._viewer.cam.elevation = 9.0, -15.0
            return
        self._context = stage.gl_context(width, height)
        self._context.make_current()
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 200)
        self._gl = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._gl)
        self._option = mujoco.MjvOption()
        self._option.sitegroup[:] = 0
        for flag in ("SHADOW", "REFLECTION", "HAZE", "SKYBOX"):  # as in the package's videos
            self._scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = False
        self._rect = mujoco.MjrRect(0, 0, width, height)
        self._pixels = np.empty((height, width, 3), dtype=np.uint8)

    def close(self) -> None:
        """Give back what is open."""
        if self._context is not None:
            self._gl.free()
            self._context.free()
        if self._viewer is not None:
            self._viewer.close()
        self._context = self._viewer = self._road = None
