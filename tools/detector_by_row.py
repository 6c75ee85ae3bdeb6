"""How well the released detectors find the corners of every row of the paper's table, and of boxes of other sizes.

    python tools/detector_by_row.py --jobs 4 --tries 2 --out runs/detector_by_row.json

Episodes are played without a graph on true corners, three scenarios a row; at every tick the detector answers the image too, and nobody
listens. An error is of a corner in the image, px; sure: of those with a score of .3 or more, which policies use. The figures of a row are
written as soon as there are any.
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import as_completed
from pathlib import Path

import numpy as np

from np_common.cli import Progress
from np_common.files import write_atomically
from np_common.parallel import workers
from np_description.domains import DOMAINS, find_domain
from np_description.objects.choice import DEFAULT
from np_description.objects.scenarios import COUNT
from np_description.objects.table import rows_of
from np_description.weights.provenance import origin

SURE = 0.3  # score from which policies use a corner
NEAR = 3.0  # px
SIZES = 0.8, 0.9, 1.1, 1.2  # times the domain's own


def main() -> None:
    """Play what the command line asks for; the last line printed is the rows as one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--domains", nargs="+", choices=list(DOMAINS), default=list(DOMAINS))
    parser.add_argument("--objects", nargs="+", default=[], help="rows, or sizes as 1.1; default: all, and four sizes")
    parser.add_argument("--engine", choices=("mujoco", "physx"), default="physx")
    parser.add_argument("--tries", type=int, default=2, help="episodes a scenario")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--weights", default="", help="folder of other weights")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    asked = [(d, name) for d in options.domains for name in options.objects or (*rows_of(d), *map(str, SIZES))]
    found: dict[tuple[str, str], dict] = {}
    progress = Progress(len(asked), "detector")
    with workers(options.jobs) as pool:
        playing = {pool.submit(row, *one, options): one for one in asked}
        for future in as_completed(playing):
            found[playing[future]] = future.result()
            progress.show(len(found))
            table = {
                "engine": options.engine,
                "tries": options.tries,
                "seed": options.seed,
                **origin(options.weights),
                "rows": [found[one] for one in asked if one in found],
            }
            write_atomically(options.out, json.dumps(table, indent=1) + "\n")
    print(json.dumps({"rows": table["rows"]}))


def row(domain: str, name: str, options: argparse.Namespace) -> dict[str, object]:
    """The figures of one row, or of a size."""
    import torch  # slow, as what follows
    from sim2real.effects.patch import Patch

    from np_description.objects.choice import domain_with
    from np_evaluation.in_process import Eyes, OneProcess
    from np_evaluation.keypoint_projector import DetectorEyes

    class Watched(Eyes):
        """True corners for who asks; what the detector says beside them, kept."""

        def __init__(self, domain, detector):
            super().__init__(domain, Patch(), options.seed)
            self._detector = detector

        def look(self, arm):
            super().look(arm)
            self._detector.look(arm)

        def seen(self, stamp):
            true, said = super().seen(stamp), self._detector.seen(stamp)
            inside = true[:, 2] > 0
            off = np.linalg.norm(said[inside, :2] - true[inside, :2], axis=1)
            errors.append(np.stack([off, said[inside, 2]], axis=1))
            return true

    class Watching(OneProcess):
        def _eyes(self):
            return Watched(self._domain, detector)

    torch.set_num_threads(1)
    text = sized(domain, float(name)) if name[0].isdigit() else name
    played_with = domain_with(domain, text)
    errors: list[np.ndarray] = []
    detector = DetectorEyes(played_with, Patch(), options.seed, options.weights)
    episodes = Watching(played_with, options.engine, seed=options.seed, weights=options.weights)
    results = [episodes.play(n, s) for s in range(1, COUNT + 1) for n in range(options.tries)]
    off, score = np.concatenate(errors).T
    sure = off[score >= SURE]
    return {
        "domain": domain,
        "object": f"{name} times {DEFAULT}" if name[0].isdigit() else name,
        "episodes": len(results),
        "images": len(errors),
        "median_px": round(float(np.median(off)), 3),
        "q95_px": round(float(np.quantile(off, 0.95)), 3),
        "sure": round(float(np.mean(score >= SURE)), 4),
        "sure_median_px": round(float(np.median(sure)), 3),
        "sure_q95_px": round(float(np.quantile(sure, 0.95)), 3),
        "sure_within_3_px": round(float(np.mean(sure <= NEAR)), 4),
    }


def sized(domain: str, factor: float) -> str:
    """A box of so many times a domain's own edges, and of its mass: the text of an object's file."""
    own = find_domain(domain)
    size = [round(2 * factor * half, 6) for half in own.half_size]
    return json.dumps(
        {"name": f"size {factor:g}", "domain": domain, "size": size, "mass": own.mass, "surface": "paper"}
    )


if __name__ == "__main__":
    main()
