"""The teleoperator: the graph's own policies lead, LeRobot records what the controller makes of it."""

from __future__ import annotations

from functools import cached_property

from lerobot.teleoperators import Teleoperator
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from sensor_msgs.msg import JointState

from np_description.message_arrays import joint_state_arrays
from np_description.panda import JOINT_NAMES

from .config_np_franka import NpEpisodeConfig
from .listener import Listener
from .robot import JOINT_ACTION


class NpEpisode(Teleoperator):
    """One episode, from `connect` on; the robot's `command` has to be `watch`."""

    config_class = NpEpisodeConfig
    name = "np_episode"

    def __init__(self, config: NpEpisodeConfig):
        super().__init__(config)
        self.config = config
        self._listener: Listener | None = None

    @cached_property
    def action_features(self) -> dict:
        """Joint targets, rad."""
        return dict.fromkeys(JOINT_ACTION, float)

    @property
    def feedback_features(self) -> dict:
        """None."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Whether a message of the controller has arrived."""
        return self._listener is not None

    @property
    def is_calibrated(self) -> bool:
        """Nothing to calibrate."""
        return True

    def calibrate(self) -> None:
        """Nothing to do."""

    def configure(self) -> None:
        """Nothing to do."""

    def connect(self, calibrate: bool = True) -> None:
        """Join the graph, draw the task and start the episode. Raises TimeoutError, or RuntimeError with the reason of a refusal."""
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f"{self.name} is connected")
        listener = Listener("lerobot_episode", {"effort_command": JointState}, self.config.timeout)
        try:
            if self.config.reset:
                _succeed(listener, self.config.reset)
            listener.client.wait_until(
                lambda: listener.client.call("episode/start").success, what="a start of the episode"
            )
            listener.start()
        except BaseException:
            listener.close()
            raise
        self._listener = listener

    def get_action(self) -> dict:
        """The controller's newest joint target."""
        if self._listener is None:
            raise DeviceNotConnectedError(f"{self.name} is not connected: call connect() first")
        position, _, _ = joint_state_arrays(self._listener.newest("effort_command"), JOINT_NAMES)
        return dict(zip(JOINT_ACTION, position.tolist()))

    def send_feedback(self, feedback: dict) -> None:
        """Nothing to feel."""

    def disconnect(self) -> None:
        """Leave the graph; the episode goes on."""
        self._listener.close()
        self._listener = None


def _succeed(listener: Listener, service: str) -> None:
    answer = listener.client.call(service)
    if not answer.success:
        raise RuntimeError(f"{service}: expected success, got: {answer.message}")
