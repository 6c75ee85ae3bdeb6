"""`export_policy FILE... [--out FOLDER]`: policies as single ONNX files, which the nodes run without PyTorch."""

from __future__ import annotations

import sys
from pathlib import Path

from np_common.cli import Parser


def main(arguments: list[str] | None = None) -> int:
    """Print the paths written, a line each."""
    parser = Parser(prog="export_policy", description=__doc__)
    parser.add_argument("files", nargs="+", type=Path, help="weights, .safetensors")
    parser.add_argument("--out", type=Path, help="folder; default: beside the weights")
    options = parser.parse_args(arguments)
    from np_description.weights.released import WeightsError
    from np_policy.onnx.export import export  # slow: no --help should wait for PyTorch

    try:
        for file in options.files:
            print(export(file, options.out))
    except (WeightsError, OSError) as error:
        print(f"export_policy: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
