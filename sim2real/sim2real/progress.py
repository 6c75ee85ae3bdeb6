"""How far a diagnosis has come, by its stages: most of the time goes into a few, whose shares are much alike."""

from __future__ import annotations

from collections.abc import Callable

from np_common.cli import Progress

STAGES = {
    "search for effects": 60,
    "what is left, and how sure it is": 20,
    "next experiment": 6,
    "the patch in the simulator": 4,
    "refit in the simulator": 8,
    "page": 2,
}
"""Per cent of the time of a diagnosis of the whole suite."""

StageCallback = Callable[[str], None]


def ignore_stage(stage: str) -> None:
    """Does nothing."""


class StageProgress:
    """Shows on stderr which stage has begun, and the time left by the shares of those that are done."""

    def __init__(self, quick: bool = False):
        stages = dict(list(STAGES.items())[:2]) if quick else STAGES
        self._begin, total = {}, 0
        for stage, share in stages.items():
            self._begin[stage], total = total, total + share
        self._total = total
        self._progress = Progress(total, "diagnose")

    def begin(self, stage: str) -> None:
        """A stage of `STAGES` begins."""
        self._progress.show(self._begin[stage], stage)

    def end(self) -> None:
        """All is done."""
        self._progress.show(self._total, "done")
