"""What LeRobot's command lines can set."""

from dataclasses import dataclass

from lerobot.robots import RobotConfig
from lerobot.teleoperators import TeleoperatorConfig

POSE, WATCH = COMMANDS = ("pose", "watch")


@RobotConfig.register_subclass("np_franka")
@dataclass(kw_only=True)
class NpFrankaConfig(RobotConfig):
    """The arm whose backend and controller run in real time in this ROS domain."""

    command: str = POSE
    """pose: actions are hand poses with gains; watch: somebody else, as `np_episode`, commands the arm, actions are kept only."""
    keypoints: bool = True
    """Observe the topic `keypoints`."""
    image: bool = True
    """Observe the topic `camera/image_raw`."""
    goal: bool = False
    """Observe the topic `goal_keypoints`, which policy `np` needs."""
    timeout: float = 20.0
    """s to wait for the first message of each topic."""

    def __post_init__(self):
        super().__post_init__()
        if self.command not in COMMANDS:
            raise ValueError(f"command: expected one of {', '.join(COMMANDS)}, got {self.command!r}")


@TeleoperatorConfig.register_subclass("np_episode")
@dataclass(kw_only=True)
class NpEpisodeConfig(TeleoperatorConfig):
    """An episode of the graph's own policies in place of a person who leads."""

    reset: str = ""
    """Service that draws a new task before the episode, as sim_bridge/reset; empty: the object lies where it lies."""
    timeout: float = 60.0
    """s to wait for the graph."""
