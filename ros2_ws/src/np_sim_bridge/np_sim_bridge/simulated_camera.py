"""A simulated camera: the scene of the moment that an image is of, drawn in a thread of its own, through the lens it has."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from sim2real.effects.camera_effects import CameraEffects

from np_sim_bridge.imaging import CameraThread
from np_sim_bridge.renderer import Renderer
from np_sim_bridge.view import SceneView


class SimulatedCamera:
    """A simulated camera of the scene that `make` builds a renderer for.

    effects: of the view; deliver(stamp ns, pixels (height, width, 3) uint8) takes an image, in the camera's thread; wait: whether
    the simulation waits where images are not drawn in time, or they are dropped. Raises what building the renderer raises.
    """

    def __init__(
        self,
        make: Callable[[], Renderer],
        effects: CameraEffects,
        deliver: Callable[[int, np.ndarray], None],
        *,
        wait: bool,
    ):
        self._view, self._wait = SceneView(effects), wait
        self._thread = CameraThread(make, lambda stamp, pixels: deliver(stamp, self._view.through_lens(pixels)))

    def begin(self) -> None:
        """Forget what was: the scene has been set up anew."""
        self._view.begin()

    def see(self, stamp: int, configuration: Callable[[], np.ndarray], *, is_due: bool) -> bool:
        """The scene, with generalised positions (nq,), of a control period at `stamp` ns, and whether an image of it is due.

        False where that image was dropped. Raises what the renderer raised on an earlier one.
        """
        self._view.keep(stamp, configuration)
        if not is_due:
            return True
        return self._thread.submit(stamp, self._view.scene(stamp, configuration), wait=self._wait)

    def close(self) -> None:
        """Finish the images under way."""
        self._thread.close()
