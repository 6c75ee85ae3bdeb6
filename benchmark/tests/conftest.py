"""Helpers that the tests of the benchmark share with those of the product."""

import sys
from pathlib import Path

from hypothesis import settings

settings.register_profile("benchmark", deadline=None)
settings.load_profile("benchmark")

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tools"), str(ROOT / "benchmark")]
