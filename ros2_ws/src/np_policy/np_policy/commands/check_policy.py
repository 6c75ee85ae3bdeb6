"""`check_policy FILE`: an exported policy against PyTorch with its weights: differences and latency as JSON."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from np_common.cli import Parser


def main(arguments: list[str] | None = None) -> int:
    """Print one JSON object; status 1 where a difference is over 1e-5 or the file does not fit."""
    parser = Parser(prog="check_policy", description=__doc__)
    parser.add_argument("file", type=Path, help="policy, .onnx")
    parser.add_argument(
        "--weights", type=Path, help=".safetensors that it was exported from; default: beside it, or released"
    )
    parser.add_argument("--steps", type=int, default=1000, help="inputs to draw")
    options = parser.parse_args(arguments)
    import torch  # slow: no --help should wait for it

    from np_description.weights.released import WeightsError, weights_folder
    from np_policy.onnx.parity import check_parity

    torch.set_num_threads(1)
    try:
        beside = options.file.with_suffix(".safetensors")
        weights = options.weights or (beside if beside.is_file() else weights_folder() / beside.name)
        found = check_parity(options.file, weights, options.steps)
    except WeightsError as error:
        print(f"check_policy: {error}", file=sys.stderr)
        return 1
    print(json.dumps({"file": str(options.file), **found}))
    return 0 if found["parity"] else 1


if __name__ == "__main__":
    raise SystemExit(main())
