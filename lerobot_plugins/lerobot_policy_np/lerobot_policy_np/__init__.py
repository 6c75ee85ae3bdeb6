"""LeRobot finds this package by its name: policy `np`."""

from .configuration_np import NpConfig
from .modeling_np import NpPolicy
from .processor_np import make_np_pre_post_processors

__all__ = ["NpConfig", "NpPolicy", "make_np_pre_post_processors"]
