"""However a loop that calls back ends, or does not: whoever reads or writes it is told. No hardware extra needed."""

from threading import Event

import pytest

from np_franka.callback_loop import CallbackLoopAdapter


def raising(error):
    """A loop that calls back once, and then raises this."""

    def loop(callback):
        callback("state", None)
        raise error

    return loop


def once(callback):
    callback("state", None)


@pytest.mark.parametrize(
    "loop, words",
    [
        (raising(RuntimeError("reflex")), "^reflex$"),
        (raising(TypeError("no such argument")), "TypeError: no such"),
        (raising(SystemExit(3)), "SystemExit: 3"),
        (once, "has ended by itself"),
    ],
)
def test_whatever_ends_the_loop_is_raised_by_every_read_from_then_on(loop, words):
    turn = CallbackLoopAdapter(loop)
    assert turn.read() == "state"
    turn.write("torques")
    for _ in range(2):
        with pytest.raises(RuntimeError, match=words):
            turn.read()
    turn.abandon()


@pytest.mark.parametrize("error", [RuntimeError("reflex"), TypeError("reflex")])
def test_what_goes_wrong_at_the_end_is_raised_by_finish(error):
    turn = CallbackLoopAdapter(raising(error))
    turn.read()
    with pytest.raises(RuntimeError, match="reflex"):
        turn.finish("torques")


def test_a_loop_that_is_finished_just_returns():
    turn = CallbackLoopAdapter(once)
    turn.read()
    turn.finish("torques")


def test_a_loop_that_hangs_is_not_waited_for(monkeypatch):
    monkeypatch.setattr("np_franka.callback_loop.TIMEOUT", 0.05)
    over = Event()
    turn = CallbackLoopAdapter(lambda _: over.wait())
    with pytest.raises(TimeoutError, match="no state within 0.05 s"):
        turn.read()
    with pytest.raises(TimeoutError, match="has not ended within 0.05 s"):
        turn.finish("torques")
    turn.abandon()
    over.set()
