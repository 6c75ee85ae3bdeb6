"""Export trained weights for ONNX Runtime, which runs the detector on a robot's CPU.

    python -m np_training.detector.export weights/keypoint_detector_card.safetensors

Writes the .onnx beside the weights, with their contract and sha256, and checks that both give the same output. Needs onnx,
onnxscript.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from np_common.cli import Parser


def main() -> None:
    """Command line; prints the path written."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights", type=Path)
    arguments = parser.parse_args()
    from np_training.detector.exporting import export  # slow: no --help should wait for PyTorch

    print(export(arguments.weights))


if __name__ == "__main__":
    main()
