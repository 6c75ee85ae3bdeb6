"""A cell of the paper's table without a graph: `np_evaluation.in_process`, a third of the processor time or less.

Results stand in a file as those of `evaluate` do, so that what is finished is not played again, and `table3 --show` finds it.
"""

from __future__ import annotations

from functools import lru_cache

from np_description.weights.provenance import origin
from np_evaluation.paper_table import OSC, Cell, Played, Setting
from np_evaluation.results import Results
from np_evaluation.scoring import breakdown, code_sha256


def play_alone(cell: Cell, setting: Setting) -> Played:
    """What came of a cell, episodes that are there already among it. Raises WeightsError where its weights do not fit."""
    import torch  # slow, as what follows

    from np_description.objects.choice import domain_with
    from np_evaluation.in_process import OneProcess

    torch.set_num_threads(1)
    results = Results(setting.out / cell.folder, settings_of(cell, setting))
    played = None
    for number in (number for run in results.missing(setting.tries) for number in run):
        played = played or OneProcess(
            domain_with(cell.domain, cell.object),
            setting.engine,
            seed=setting.seed,
            contacts=setting.contacts,
            weights=setting.weights[cell.method],
            keypoints=setting.keypoints,
            controller=_controller(cell),
        )
        try:
            result = played.play(number, cell.scenario)
        except FloatingPointError as error:
            result = breakdown(number, str(error), 0.0)
        results.add(result)
    return Played(cell, tuple(results.results[: setting.tries]))


def settings_of(cell: Cell, setting: Setting) -> dict[str, object]:
    """What names a cell's results: everything they depend on."""
    return {
        "domain": cell.domain,
        "engine": setting.engine,
        "seed": setting.seed,
        "keypoints": setting.keypoints,
        "controller": _controller(cell),
        "object": cell.object,
        "scenario": cell.scenario,
        "contacts": setting.contacts,
        "graph": False,
        "code_sha256": _code(),
        **origin(setting.weights[cell.method]),
    }


def _controller(cell: Cell) -> str:
    return OSC if cell.method == OSC else "impedance"


@lru_cache(maxsize=1)
def _code() -> str:
    return code_sha256()
