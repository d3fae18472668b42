"""Draws one instant of a run: the car on its road, the prediction, the forces and the wind.

The tires' forces are drawn over the picture with OpenCV, since the body would hide them; all else
stands in MuJoCo's scene.
"""

from __future__ import annotations

import math
import os
import sys
import warnings
from collections.abc import Callable
from typing import Any

import cv2
import mujoco
import numpy as np
import numpy.typing as npt

from lpvmpc.errors import RenderError
from lpvmpc.picture.video.scenery import Scenery, build
from lpvmpc.units import Array

Image = npt.NDArray[np.uint8]

WHEELS = ("fl", "fr", "rl", "rr")
SIGHT = 260.0
"""Distance to which the road and what stands beside it are drawn [m]."""
ARROW = 0.6e-3
"""Length of a force arrow [m/N]."""
LADDER = 0.98
"""Half width of the ladder that shows the prediction [m]; just wider than the car."""
ORANGE, AIR = (0.90, 0.50, 0.05), (0.42, 0.66, 0.84)
USER, GLASS = (0.78, 0.76, 0.72, 1.0), (0.16, 0.18, 0.21, 1.0)
RUBBER, LIGHT = (0.06, 0.06, 0.06, 1.0), (0.75, 0.06, 0.05, 1.0)
"""Colours of another road user."""


class Chase:
    """Camera behind the car that looks where the road goes.

    Its heading follows the road's, `LOOK_AHEAD` seconds before the car, as a critically damped
    second-order system: psi'' = w^2 (target - psi) - 2 w psi'. It swings through bends without
    overshoot, and does not shake with the car.
    """

    LOOK_AHEAD = 0.7
    W = 2.6
    BESIDE = math.radians(-17.0)
    """Angle to the car's tail: wheels, forces and predicted path stay visible [rad]."""

    def __init__(self, path: Any, dt: float) -> None:
        """Args: the path driven, and the time between frames [s]."""
        self.path, self.dt = path, dt
        self.heading: float | None = None
        self.rate = 0.0
        self.camera = mujoco.MjvCamera()
        self.camera.type = mujoco.mjtCamera.mjCAMERA_FREE

    def follow(self, now: dict[str, Any]) -> mujoco.MjvCamera:
        """Camera of the next frame."""
        ahead = now["s_m"] + self.LOOK_AHEAD * max(now["vx_mps"], 0.0)
        target = float(self.path.at(ahead)[2])
        if self.heading is None:
            self.heading = target
        # exact step of the critically damped system towards a constant target
        error, decay = self.heading - target, math.exp(-self.W * self.dt)
        slope = self.rate + self.W * error
        self.heading = target + (error + slope * self.dt) * decay
        self.rate = (self.rate - self.W * slope * self.dt) * decay
        c, s = math.cos(self.heading), math.sin(self.heading)
        self.camera.lookat[:] = (now["x_m"] + 2.0 * c, now["y_m"] + 2.0 * s, 0.1)
        self.camera.distance = 10.5
        self.camera.azimuth = math.degrees(self.heading + self.BESIDE)
        self.camera.elevation = -16.0
        return self.camera


class Stage:
    """Draws the world: car, road, roadside, predicted path, forces and wind."""

    def __init__(self, log: Any, width: int, height: int, dt: float,
                 chase: Chase | None = None) -> None:
        """Compile the scene for the log's road and open OpenGL.

        Raises:
            RenderError: No OpenGL on this machine.
        """
        self.context = gl_context(width, height)
        self.context.make_current()
        try:
            scenario = log.scenario
            self.scenery: Scenery = build(log.road or scenario.path, width=width, height=height,
                                          cones=scenario.cones)
            self.users = log.meta.get("traffic", [])
            model = self.model = self.scenery.model
            self.data = mujoco.MjData(model)
            self.scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 200)
            self.gl = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self.gl)
        except BaseException:
            self.context.free()
            raise
        self.option = mujoco.MjvOption()
        self.option.sitegroup[:] = 0
        self.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        self.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        self.scene.flags[mujoco.mjtRndFlag.mjRND_HAZE] = False
        self.scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = False  # there is a dome
        self.rect = mujoco.MjrRect(0, 0, width, height)
        self.pixels = np.empty((height, width, 3), dtype=np.uint8)
        self.chase = chase or Chase(log.scenario.path, dt)
        self.patch = [int(model.site(f"contact_{wheel}").id) for wheel in WHEELS]
        self.perturb = mujoco.MjvPerturb()

    def picture(self, now: dict[str, Any]) -> Image:
        """RGB picture of one instant, shape (height, width, 3)."""
        model, data = self.model, self.data
        data.qpos[:] = now["qpos"]
        self.scenery.place(data, now["x_m"], now["y_m"], now["psi_rad"], SIGHT)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        self.context.make_current()
        mujoco.mjv_updateScene(model, data, self.option, self.perturb, self.chase.follow(now),
                               mujoco.mjtCatBit.mjCAT_ALL, self.scene)
        self._horizon(now["horizon"])
        self._wind(now)
        for i, user in enumerate(self.users):
            place = (now[f"user{i}_{name}"] for name in ("x_m", "y_m", "psi_rad"))
            draw_user(self._add, user, *place)
        mujoco.mjr_render(self.rect, self.scene, self.gl)
        mujoco.mjr_readPixels(self.pixels, None, self.rect, self.gl)
        frame = np.ascontiguousarray(self.pixels[::-1])  # OpenGL's first row is the lowest
        self._forces(frame, now)
        return frame

    def close(self) -> None:
        """Give OpenGL's resources back."""
        self.gl.free()
        self.context.free()

    def _add(self, *what: Any) -> Any:
        """One more body to draw in this frame; see `add`."""
        return add(self.scene, *what)

    def _arrow(self, start: Any, end: Any, thickness: float, colour: Any) -> None:
        geom = self._add(mujoco.mjtGeom.mjGEOM_ARROW, np.ones(3), np.zeros(3), colour)
        if geom is not None:
            mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_ARROW, thickness,
                                 np.asarray(start, float), np.asarray(end, float))

    def _horizon(self, points: Array) -> None:
        """Predicted path as a ladder on the road, as wide as the car, a rung per period."""
        points = points[np.isfinite(points).all(axis=1)]
        for a, b in zip(points[:-1], points[1:], strict=True):
            length = float(np.hypot(*(b - a)))
            if length < 1e-3:
                continue
            c, s = (b - a) / length
            frame = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
            left = np.array((-s, c))
            for side in (-LADDER, LADDER):
                self._add(mujoco.mjtGeom.mjGEOM_BOX, (0.51 * length, 0.05, 0.003),
                          (*(0.5 * (a + b) + side * left), 0.02), (*ORANGE, 1.0), frame)
            self._add(mujoco.mjtGeom.mjGEOM_BOX, (0.03, LADDER, 0.003), (*b, 0.02),
                      (*ORANGE, 1.0), frame)

    def _forces(self, frame: Image, now: dict[str, Any]) -> None:
        """Tire force at each contact patch, in the plane of the road, seen through the body.

        Green to red: the share of the friction mu Fz that is used.
        """
        width = max(frame.shape[0] // 120, 2)
        for wheel, site in zip(WHEELS, self.patch, strict=True):
            Fx, Fy, Fz = (now[f"F{a}_{wheel}_N"] for a in "xyz")
            if not math.isfinite(Fx + Fy + Fz) or Fz <= 0.0:
                continue
            c, s = self.data.site_xmat[site].reshape(3, 3)[:2, 0]
            x, y, z = self.data.site_xpos[site]
            tip = (x + ARROW * (c * Fx - s * Fy), y + ARROW * (s * Fx + c * Fy), z)
            ends = self.project(np.array(((x, y, z), tip)), frame.shape)
            if not np.isfinite(ends).all() or np.hypot(*(ends[1] - ends[0])) < width:
                continue
            use = min(float(np.hypot(Fx, Fy)) / max(now[f"mu_{wheel}"] * Fz, 1.0), 1.0)
            colour = (int(70 + 185 * min(2.0 * use, 1.0)), int(225 - 150 * max(use - 0.3, 0.0)), 70)
            (u0, v0), (u1, v1) = np.round(ends).astype(int).tolist()
            share = min(2.6 * width / float(np.hypot(u1 - u0, v1 - v0)), 0.45)
            for thick, ink in ((width + 3, (20, 24, 28)), (width, colour)):
                cv2.arrowedLine(frame, (u0, v0), (u1, v1), ink, thick, cv2.LINE_AA, 0, share)

    def project(self, points: Array, shape: tuple[int, ...]) -> Array:
        """Pixels (column, row) of points of the world (n, 3); NaN behind the camera."""
        eyes = self.scene.camera
        eye = 0.5 * (np.asarray(eyes[0].pos) + np.asarray(eyes[1].pos))
        ahead, up = np.asarray(eyes[0].forward), np.asarray(eyes[0].up)
        seen = (points - eye) @ np.stack([np.cross(ahead, up), up, ahead], axis=1)  # (n, 3)
        half = 0.5 * (eyes[0].frustum_top - eyes[0].frustum_bottom) / eyes[0].frustum_near
        scale = 0.5 * shape[0] / half / np.where(seen[:, 2] > 0.1, seen[:, 2], np.nan)
        return np.stack([0.5 * shape[1] + scale * seen[:, 0],
                         0.5 * shape[0] - scale * seen[:, 1]], axis=1)

    def _wind(self, now: dict[str, Any]) -> None:
        """Wind as arrows on the windward side of the car; wind > 0 blows from the left."""
        speed = now["wind_mps"]
        if not math.isfinite(speed) or abs(speed) < 0.5:
            return
        c, s = math.cos(now["psi_ref_rad"]), math.sin(now["psi_ref_rad"])
        blow = math.copysign(1.0, speed) * np.array((s, -c))
        length = 0.035 * abs(speed)
        for along in (-1.1, 0.0, 1.1):
            tip = np.array((now["x_m"] + along * c, now["y_m"] + along * s)) - 1.15 * blow
            self._arrow((*(tip - length * blow), 1.0), (*tip, 1.0), 0.05, (*AIR, 1.0))


def add(scene: Any, kind: Any, size: Any, place: Any, colour: Any, frame: Any = None) -> Any:
    """One more body to draw in a scene's frame; silently none when the scene is full."""
    if scene.ngeom >= scene.maxgeom:
        return None
    geom = scene.geoms[scene.ngeom]
    scene.ngeom += 1
    mujoco.mjv_initGeom(geom, kind, np.asarray(size, float), np.asarray(place, float),
                        (np.eye(3) if frame is None else frame).ravel(),
                        np.asarray(colour, np.float32))
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR
    geom.emission = 0.35
    geom.specular = 0.0
    return geom


def draw_user(
    add: Callable[..., Any], user: dict[str, Any], x: float, y: float, psi: float
) -> None:
    """Another road user: a plain body with a cabin, wheels and tail lights.

    Args:
        add: Adds a body to the frame, by kind, size, place, colour and axes.
        user: Its length_m, width_m and height_m.
        x: Its middle [m].
        y: The same [m].
        psi: Its heading [rad].
    """
    half, wide, high = (0.5 * user[name] for name in ("length_m", "width_m", "height_m"))
    c, s = math.cos(psi), math.sin(psi)
    frame = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))

    def box(ahead: float, left: float, up: float, size: Any, colour: Any) -> None:
        add(mujoco.mjtGeom.mjGEOM_BOX, size,
            (x + c * ahead - s * left, y + s * ahead + c * left, up), colour, frame)

    box(0.0, 0.0, 0.65 * high, (half, wide, 0.45 * high), USER)
    box(-0.1 * half, 0.0, 1.5 * high, (0.6 * half, 0.9 * wide, 0.45 * high), GLASS)
    for ahead in (-0.62 * half, 0.62 * half):
        for left in (-wide, wide):
            box(ahead, 0.93 * left, 0.28, (0.3, 0.1, 0.28), RUBBER)
    for left in (-0.75 * wide, 0.75 * wide):
        box(-half, left, 0.8 * high, (0.03, 0.18 * wide, 0.1 * high), LIGHT)


def gl_context(width: int, height: int) -> Any:
    """An OpenGL context without a window: EGL (on Linux), or what MUJOCO_GL says.

    Raises:
        RenderError: It cannot be opened; the sentence names what to install.
    """
    usual = "egl" if sys.platform.startswith("linux") else "glfw"
    backend = os.environ.get("MUJOCO_GL", "").lower().strip() or usual
    try:
        if backend == "egl":
            from mujoco.egl import GLContext
        elif backend == "osmesa":
            from mujoco.osmesa import GLContext
        elif backend in ("glfw", "on", "enable", "enabled", "true", "1"):
            import glfw
            from mujoco.glfw import GLContext

            with warnings.catch_warnings():
                warnings.simplefilter("ignore", glfw.GLFWError)  # said in our own words instead
                context = GLContext(width, height) if glfw.init() else None
            if context is None or not context._context:
                raise RenderError("No OpenGL through glfw, which needs a display; unset MUJOCO_GL, "
                                  "or set it to egl or osmesa.")
            return context
        else:
            raise RenderError(f"MUJOCO_GL is {backend!r}, which draws nothing; unset it, or set it "
                              "to egl, osmesa or glfw.")
        return GLContext(width, height)
    except RenderError:
        raise
    except Exception as error:  # PyOpenGL raises whatever it runs into
        raise RenderError(
            f"No OpenGL through {backend} ({type(error).__name__}); on Debian and Ubuntu install "
            "it with `apt-get install libegl1 libgl1-mesa-dri libegl-mesa0`.") from error
