"""The policy's observations and actions, in LeRobot's terms."""

from dataclasses import dataclass, field

from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature, PreTrainedConfig
from lerobot.utils.constants import ACTION, OBS_STATE

STATE_SIZE, ACTION_SIZE = 67, 21


@PreTrainedConfig.register_subclass("np")
@dataclass
class NpConfig(PreTrainedConfig):
    """A policy that was trained elsewhere: nothing of it can be trained here."""

    file: str = ""
    """The .onnx that export_policy wrote."""
    domain: str = "card"
    """Task that it was trained for."""
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: {"STATE": NormalizationMode.IDENTITY, "ACTION": NormalizationMode.IDENTITY}
    )
    input_features: dict[str, PolicyFeature] = field(
        default_factory=lambda: {OBS_STATE: PolicyFeature(type=FeatureType.STATE, shape=(STATE_SIZE,))}
    )
    output_features: dict[str, PolicyFeature] = field(
        default_factory=lambda: {ACTION: PolicyFeature(type=FeatureType.ACTION, shape=(ACTION_SIZE,))}
    )

    @property
    def observation_delta_indices(self) -> None:
        """No history: the policy keeps its own."""
        return None

    @property
    def action_delta_indices(self) -> None:
        """One action at a time."""
        return None

    @property
    def reward_delta_indices(self) -> None:
        """None."""
        return None

    def get_optimizer_preset(self):
        """Raises NotImplementedError."""
        raise NotImplementedError("policy np is trained by np_training, not by LeRobot")

    def get_scheduler_preset(self) -> None:
        """None."""
        return None

    def validate_features(self) -> None:
        """Raises ValueError for another observation than that of robot np_franka with its goal."""
        shape = tuple(self.input_features[OBS_STATE].shape)
        if shape != (STATE_SIZE,):
            raise ValueError(f"{OBS_STATE}: expected ({STATE_SIZE},), with --robot.goal=true, got {shape}")
