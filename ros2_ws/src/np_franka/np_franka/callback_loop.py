"""A control loop that calls back, turned into `read` and `write`. No ROS."""

from __future__ import annotations

from collections.abc import Callable
from queue import Empty, SimpleQueue
from threading import Thread

TIMEOUT = 1.5  # s for the other thread: libfranka gives a robot up after 1 s, and its own error is more precise


class CallbackLoopAdapter:
    """Runs `loop` in a thread of its own; at any time one of the two threads waits for the other.

    loop: is given a callback from (state, duration) to torques, and calls it until the motion is over. However
    it ends, every later `read` and `finish` raises a RuntimeError with the cause, but for a `finish` after which
    it has just returned. Where it neither calls back nor ends, they raise TimeoutError."""

    def __init__(self, loop: Callable[[Callable], None]):
        self._states: SimpleQueue = SimpleQueue()  # None: the loop has ended
        self._answers: SimpleQueue = SimpleQueue()
        self._error: BaseException | None = None  # with which it has
        self._thread = Thread(target=self._run, args=(loop,), daemon=True)
        self._thread.start()

    def read(self) -> object:
        """Wait for the next state. RuntimeError, TimeoutError."""
        try:
            state = self._states.get(timeout=TIMEOUT)
        except Empty:
            raise TimeoutError(f"no state within {TIMEOUT:g} s") from None
        if state is None:
            self._states.put(None)  # for the next call of read
            self._raise()
            raise RuntimeError("the control loop has ended by itself")
        return state

    def write(self, torques: object) -> None:
        """Reply to the state just read."""
        self._answers.put(torques)

    def finish(self, torques: object) -> None:
        """Reply with the last torques and wait for the loop's end. RuntimeError, TimeoutError."""
        self._answers.put(torques)
        self._thread.join(TIMEOUT)
        if self._thread.is_alive():
            raise TimeoutError(f"the motion has not ended within {TIMEOUT:g} s")
        self._raise()

    def abandon(self) -> None:
        """End the loop by an error in place of a reply, and wait for it, but not for ever."""
        self._answers.put(None)
        self._thread.join(TIMEOUT)

    def _raise(self) -> None:
        """Raise what the loop has ended with: its own RuntimeError, or one that names anything else."""
        if isinstance(self._error, RuntimeError):
            raise self._error
        if self._error is not None:
            raise RuntimeError(f"{type(self._error).__name__}: {self._error}") from self._error

    def _run(self, loop: Callable[[Callable], None]) -> None:
        try:
            loop(self._call)
        except BaseException as error:  # whatever it is: the other thread waits, and nothing else reports it
            self._error = error
        finally:
            self._states.put(None)

    def _call(self, state: object, _duration: object) -> object:
        self._states.put(state)
        torques = self._answers.get()
        if torques is None:
            raise RuntimeError("the motion was abandoned")
        return torques
