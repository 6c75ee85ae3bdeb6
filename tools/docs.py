"""`make docs`: write the pages of docs that follow from data or code. The last line printed is one JSON object."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from pages import driver, effects, evaluations, objects, parameters, report_schema, setup_drawing, training
from pages.markdown import fill

ROOT = Path(__file__).resolve().parents[1]


def generate(root: Path = ROOT) -> dict[str, str]:
    """Text of every page with generated parts, by its path."""
    results = root / "docs/results"
    hardware, readme = ((root / name).read_text(encoding="utf-8") for name in ("docs/guide/hardware.md", "README.md"))
    stops = (evaluations.reflex_stops(results, ("bump", "wall"), engine) for engine in ("MuJoCo", "PhysX"))
    return {
        "README.md": fill(
            readme, successes=evaluations.summary(results), stops="In MuJoCo {}, in PhysX {}".format(*stops)
        ),
        "docs/guide/hardware.md": fill(hardware, forces=evaluations.forces_by_truth(results)),
        "docs/guide/images/setup.svg": setup_drawing.drawing(),
        "docs/reference/effects.md": effects.page(),
        "docs/reference/objects.md": objects.page(),
        "docs/reference/parameters.md": parameters.page(root),
        "docs/reference/report_schema.md": report_schema.page(),
        "docs/results/driver.md": driver.page(results / "driver.json"),
        "docs/results/evaluations.md": evaluations.page(results),
        "docs/results/training.md": training.page(results),
    }


def main() -> None:
    """Write the pages below --out."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT)
    out = parser.parse_args().out
    written = generate()
    for name, text in written.items():
        path = out / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    print(json.dumps({"pages": len(written), "out": str(out)}))


if __name__ == "__main__":
    main()
