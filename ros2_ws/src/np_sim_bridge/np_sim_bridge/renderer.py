"""Camera images without a display: OpenGL through EGL where it works, else a ray caster on the CPU.

Both draw the same primitives with the same lights; tests/np_sim_bridge/test_renderer.py holds them to the same pixels.
A renderer belongs to the thread that made it (OpenGL contexts do).
"""

from __future__ import annotations

import subprocess
import sys
from typing import Protocol

import mujoco
import numpy as np

from np_description.scene import CAMERA_NAME

RENDERERS = ("auto", "egl", "warp")
_PROBE = "from np_sim_bridge.renderer import probe_egl; probe_egl()"
_PROBE_TIMEOUT = 30  # s


class Renderer(Protocol):
    """Draws the scene's camera."""

    def render(self, configuration: np.ndarray) -> np.ndarray:
        """Pixels (height, width, 3) uint8 RGB of generalised positions (nq,)."""

    def close(self) -> None:
        """Release what the renderer holds."""


def make_renderer(kind: str, model: mujoco.MjModel, *, shadows: bool = True) -> Renderer:
    """The renderer called `kind` for the camera of `model`; `auto` takes EGL if a trial picture comes out.

    Raises ValueError for an unknown kind, and what OpenGL raises where `egl` is requested and does not work.
    """
    if kind not in RENDERERS:
        raise ValueError(f"renderer: expected one of {', '.join(RENDERERS)}, got {kind!r}")
    if kind == "egl" or (kind == "auto" and egl_works()):
        return EglRenderer(model, shadows=shadows)
    return WarpRenderer(model, shadows=shadows)


def egl_works() -> bool:
    """Whether a child process can draw a red ball through EGL: a broken driver may abort its process."""
    try:
        return (
            subprocess.run(
                [sys.executable, "-c", _PROBE],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                timeout=_PROBE_TIMEOUT,
                check=False,
            ).returncode
            == 0
        )
    except (OSError, subprocess.TimeoutExpired):
        return False


def probe_egl() -> None:
    """Draw a red ball. Raises if the picture is not one."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_light(pos=[0, 0, 3])
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.5, 0, 0], rgba=[1, 0, 0, 1])
    spec.worldbody.add_camera(name=CAMERA_NAME, pos=[0, 0, 2], resolution=[32, 32])
    model = spec.compile()
    renderer = EglRenderer(model)
    red, green, blue = renderer.render(model.qpos0)[16, 16].tolist()
    renderer.close()
    if not red > 100 > max(green, blue):
        raise RuntimeError(f"EGL: expected a red ball, got a pixel of ({red}, {green}, {blue})")


class _Pose:
    """Poses of everything that is drawn, from generalised positions, on data of its own."""

    def __init__(self, model: mujoco.MjModel):
        self.model, self.data = model, mujoco.MjData(model)
        self.camera = model.camera(CAMERA_NAME).id
        self.width, self.height = map(int, model.cam_resolution[self.camera])

    def update(self, configuration: np.ndarray) -> None:
        self.data.qpos[:] = configuration
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)


class EglRenderer:
    """MuJoCo's OpenGL renderer in an EGL context."""

    def __init__(self, model: mujoco.MjModel, *, shadows: bool = True):
        self._context = None
        # Not mujoco.Renderer: it follows the environment variable MUJOCO_GL, read when mujoco is imported.
        from mujoco.egl import GLContext

        self._pose = pose = _Pose(model)
        self._gl = GLContext(pose.width, pose.height)
        self._gl.make_current()
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._scene = mujoco.MjvScene(model, maxgeom=1000)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = shadows
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        self._option = mujoco.MjvOption()
        self._view = mujoco.MjvCamera()
        self._view.type, self._view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, pose.camera
        self._rect = mujoco.MjrRect(0, 0, pose.width, pose.height)
        self._pixels = np.empty((pose.height, pose.width, 3), np.uint8)

    def render(self, configuration: np.ndarray) -> np.ndarray:
        """See Renderer."""
        pose = self._pose
        pose.update(configuration)
        self._gl.make_current()  # another renderer of this thread may have been
        mujoco.mjv_updateScene(
            pose.model, pose.data, self._option, None, self._view, mujoco.mjtCatBit.mjCAT_ALL, self._scene
        )
        mujoco.mjr_render(self._rect, self._scene, self._context)
        mujoco.mjr_readPixels(self._pixels, None, self._rect, self._context)
        return self._pixels[::-1].copy()  # OpenGL counts rows from below

    def close(self) -> None:
        """See Renderer."""
        if self._context is not None:
            self._gl.make_current()
            self._context.free()
            self._gl.free()
            self._context = None

    # Left to itself, the context would free its names in whichever OpenGL context is current by then.
    __del__ = close


class WarpRenderer:
    """MuJoCo Warp's ray caster on the CPU. Its kernels are compiled once (about 15 s) and cached by Warp."""

    def __init__(self, model: mujoco.MjModel, *, shadows: bool = True):
        import warp as wp

        wp.config.quiet = True
        wp.config.log_level = wp.LOG_ERROR
        import mujoco_warp

        self._warp, self._mujoco_warp = wp, mujoco_warp
        self._pose = pose = _Pose(model)
        pose.update(model.qpos0)
        with wp.ScopedDevice("cpu"):
            self._model = mujoco_warp.put_model(model)
            self._data = mujoco_warp.put_data(model, pose.data)
            # A shadowed point keeps nothing of the light, as in OpenGL.
            self._context = mujoco_warp.create_render_context(
                model,
                cam_active=[CAMERA_NAME],
                render_rgb=True,
                use_shadows=shadows,
                shadow_light_fraction=0.0,
                render_skybox=True,
            )
            self._image = wp.zeros((1, pose.height, pose.width), dtype=wp.vec3f)
        self.render(model.qpos0)  # compiles

    def render(self, configuration: np.ndarray) -> np.ndarray:
        """See Renderer."""
        source, target = self._pose.data, self._data
        self._pose.update(configuration)
        for name in ("geom_xpos", "geom_xmat", "cam_xpos", "cam_xmat", "light_xpos", "light_xdir"):
            array = getattr(target, name)
            array.assign(getattr(source, name).reshape(array.numpy().shape))
        with self._warp.ScopedDevice("cpu"):
            self._mujoco_warp.refit_bvh(self._model, target, self._context)
            self._mujoco_warp.render(self._model, target, self._context)
            self._mujoco_warp.get_rgb(self._context, 0, self._image)
        return np.rint(self._image.numpy()[0] * 255).astype(np.uint8)

    def close(self) -> None:
        """See Renderer."""
