"""Images in a thread of their own: a frame takes longer than a control period."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Callable

import numpy as np

from np_sim_bridge.renderer import Renderer


class CameraThread:
    """Draws what is submitted, in order, and hands each image over in its thread.

    make: builds the renderer (in the thread, as OpenGL requires); deliver(stamp ns, pixels (height, width,
    3) uint8) takes an image. Constructing waits for the renderer and raises what building it raised.
    """

    def __init__(self, make: Callable[[], Renderer], deliver: Callable[[int, np.ndarray], None]):
        self._make, self._deliver = make, deliver
        self._waiting: queue.Queue = queue.Queue(maxsize=1)
        self._error: BaseException | None = None
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()
        self._ready.wait()
        self._check()

    def submit(self, stamp: int, configuration: np.ndarray, *, wait: bool) -> bool:
        """Have the scene at generalised positions (nq,) drawn as the image of `stamp` ns.

        With `wait` the call blocks while two images are under way; else it returns False and drops the image.
        Raises what the renderer raised on an earlier image.
        """
        self._check()
        while self._thread.is_alive():
            try:
                self._waiting.put((stamp, configuration), block=wait, timeout=1.0)
                return True
            except queue.Full:
                if not wait:
                    return False
        self._check()
        return False

    def close(self) -> None:
        """Finish the images under way and end the thread."""
        while self._thread.is_alive():
            try:
                self._waiting.put(None, timeout=1.0)
                break
            except queue.Full:
                continue
        self._thread.join()

    def _check(self) -> None:
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        # Threads have a priority of their own in Linux, and those that OpenGL starts inherit it: drawing yields to control.
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 10)
        try:
            renderer = self._make()
            self._ready.set()
            try:
                while (item := self._waiting.get()) is not None:
                    stamp, configuration = item
                    self._deliver(stamp, renderer.render(configuration))
            finally:
                renderer.close()
        except BaseException as error:  # handed to the thread that submits
            self._error = error
        finally:
            self._ready.set()
