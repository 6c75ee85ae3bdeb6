"""Normalisation and decoding are in the ONNX file: a batch of one is made, nothing else."""

from __future__ import annotations

from lerobot.processor import make_default_pre_post_processors

from .configuration_np import NpConfig


def make_np_pre_post_processors(config: NpConfig, dataset_stats=None):
    """LeRobot's default pipelines, without statistics."""
    return make_default_pre_post_processors(config, None)
