"""A control loop that calls back, turned into `read` and `write`. No ROS."""

from __future__ import annotations

from collections.abc import Callable
from queue import SimpleQueue
from threading import Thread


class Turnstile:
    """Runs `loop` in a thread of its own; at any time one of the two threads waits for the other.

    loop: is given a callback from (state, duration) to torques, and calls it until the motion is over; it
    may end with a RuntimeError."""

    def __init__(self, loop: Callable[[Callable], None]):
        self._states: SimpleQueue = SimpleQueue()
        self._answers: SimpleQueue = SimpleQueue()
        self._thread = Thread(target=self._run, args=(loop,), daemon=True)
        self._thread.start()

    def read(self) -> object:
        """Wait for the next state. Raises what the loop has ended with."""
        state = self._states.get()
        if isinstance(state, RuntimeError):
            raise state
        return state

    def write(self, torques: object) -> None:
        """Answer the state just read."""
        self._answers.put(torques)

    def finish(self, torques: object) -> None:
        """Answer with the last torques and wait for the loop's end. Raises what it has ended with."""
        self._answers.put(torques)
        self._thread.join()
        if not self._states.empty():
            raise self._states.get()

    def abandon(self) -> None:
        """End the loop by an error in place of an answer."""
        self._answers.put(None)
        self._thread.join()

    def _run(self, loop: Callable[[Callable], None]) -> None:
        try:
            loop(self._call)
        except RuntimeError as error:
            self._states.put(error)

    def _call(self, state: object, _duration: object) -> object:
        self._states.put(state)
        torques = self._answers.get()
        if torques is None:
            raise RuntimeError("the motion was abandoned")
        return torques
