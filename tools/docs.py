"""`make docs`: write the pages of docs that follow from data or code. The last line printed is one JSON object."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from pages import driver, effects, evaluations, objects, parameters, report_schema, setup_drawing, training

ROOT = Path(__file__).resolve().parents[1]


def generate(root: Path = ROOT) -> dict[str, str]:
    """Text of every generated page by its path below docs."""
    return {
        "guide/images/setup.svg": setup_drawing.drawing(),
        "reference/effects.md": effects.page(),
        "reference/objects.md": objects.page(),
        "reference/parameters.md": parameters.page(root),
        "reference/report_schema.md": report_schema.page(),
        "results/driver.md": driver.page(root / "docs/results/driver.json"),
        "results/evaluations.md": evaluations.page(root / "docs/results"),
        "results/training.md": training.page(root / "docs/results"),
    }


def main() -> None:
    """Write the pages below --out."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs")
    out = parser.parse_args().out
    written = generate()
    for name, text in written.items():
        path = out / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    print(json.dumps({"pages": len(written), "out": str(out)}))


if __name__ == "__main__":
    main()
