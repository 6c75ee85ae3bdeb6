"""A renderer in a process of its own: in real time, drawing must not hold the interpreter that control runs in.

The parent sends the model once and then configurations; the child replies to each with the pixels. Both sides are this
file: `python -m np_sim_bridge.renderer_process` is the child.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from contextlib import suppress

import mujoco
import numpy as np

from np_description.scene import CAMERA_NAME
from np_sim_bridge.renderer import make_renderer


class RendererProcess:
    """Draws like the renderer that `make_renderer` would give for the same arguments, elsewhere.

    Raises RuntimeError, with the child's last output, if it cannot draw.
    """

    def __init__(self, kind: str, model: mujoco.MjModel, *, shadows: bool = True):
        camera = model.camera(CAMERA_NAME).id
        width, height = map(int, model.cam_resolution[camera])
        self._shape = height, width, 3
        # Mesa draws with as many threads as there are cores; one leaves the others to control.
        environment = {"LP_NUM_THREADS": "1", **os.environ}
        self._child = subprocess.Popen(
            [sys.executable, "-m", "np_sim_bridge.renderer_process"],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        self._send(pickle.dumps((kind, model, shadows)))
        self._receive(1)  # ready

    def render(self, configuration: np.ndarray) -> np.ndarray:
        """Pixels (height, width, 3) uint8 RGB of generalised positions (nq,)."""
        self._send(np.ascontiguousarray(configuration, dtype=np.float64).tobytes())
        return np.frombuffer(self._receive(int(np.prod(self._shape))), np.uint8).reshape(self._shape)

    def close(self) -> None:
        """End the child: it leaves when nothing more can come."""
        for pipe in (self._child.stdin, self._child.stdout, self._child.stderr):
            with suppress(BrokenPipeError):  # what was still to be sent to a child that has gone
                pipe.close()
        try:
            self._child.wait(timeout=5)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()

    def _send(self, data: bytes) -> None:
        try:
            self._child.stdin.write(len(data).to_bytes(8, "little") + data)
            self._child.stdin.flush()
        except BrokenPipeError as error:
            raise self._failure() from error

    def _receive(self, size: int) -> bytes:
        data = self._child.stdout.read(size)
        if len(data) != size:
            raise self._failure()
        return data

    def _failure(self) -> RuntimeError:
        words = self._child.stderr.read().decode(errors="replace").strip().splitlines()
        return RuntimeError(
            f"renderer process: expected an image, it ended: {words[-1] if words else 'without a word'}"
        )


def main() -> None:
    """The child: reads from standard input, writes to standard output, ends with its input."""
    source, sink = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not stand between the pixels

    def receive() -> bytes:
        size = source.read(8)
        return source.read(int.from_bytes(size, "little")) if len(size) == 8 else b""

    kind, model, shadows = pickle.loads(receive())
    renderer = make_renderer(kind, model, shadows=shadows)
    try:
        sink.write(b"\n")
        sink.flush()
        while data := receive():
            sink.write(np.ascontiguousarray(renderer.render(np.frombuffer(data))).tobytes())
            sink.flush()
    except BrokenPipeError:
        pass  # the parent has gone
    finally:
        renderer.close()


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        pass
