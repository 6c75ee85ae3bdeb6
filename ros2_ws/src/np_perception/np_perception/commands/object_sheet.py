"""`object_sheet --domain card --out card.pdf`: the object's faces in the colours that the detectors were trained with, to print, cut out and glue on, to scale."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from np_common.cli import Parser
from np_description.domains import DOMAINS
from np_description.objects.choice import DEFAULT, domain_with


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object."""
    parser = Parser(prog="object_sheet", description=__doc__)
    parser.add_argument("--domain", choices=sorted(DOMAINS), default="card", help="whose object (default: %(default)s)")
    parser.add_argument(
        "--object", default=DEFAULT, help="a row of the paper's table, or a .yaml file (default: its own)"
    )
    parser.add_argument("--out", type=Path, required=True, help="PDF to write, A4")
    options = parser.parse_args(arguments)
    try:
        domain = domain_with(options.domain, options.object)
        # Slow to import, and not needed by --help.
        from PIL import Image

        from np_perception.object_sheet import DPI, pages

        size = [round(2 * half, 6) for half in domain.half_size]
        name = domain.name if options.object == DEFAULT else f"{domain.name}, {domain.object.name}"
        title = f"{name}, {' x '.join(f'{1e3 * side:g}' for side in size)} mm"
        first, *others = (Image.fromarray(page) for page in pages(domain.half_size, title))
        options.out.parent.mkdir(parents=True, exist_ok=True)
        # The format is named: PIL goes by the suffix, and others hold one page.
        first.save(options.out, "PDF", save_all=True, append_images=others, resolution=DPI, quality=95)
    except (OSError, ValueError) as error:
        print(f"object_sheet: {error}", file=sys.stderr)
        print(json.dumps({"error": str(error)}))
        return 1
    print(json.dumps({"sheet": str(options.out), "pages": 1 + len(others), "size_m": size}))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
