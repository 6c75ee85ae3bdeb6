"""LeRobot finds this package by its name: robot `np_franka`, teleoperator `np_episode`."""

from .config_np_franka import NpEpisodeConfig, NpFrankaConfig
from .episode import NpEpisode
from .robot import NpFranka

__all__ = ["NpEpisode", "NpEpisodeConfig", "NpFranka", "NpFrankaConfig"]
