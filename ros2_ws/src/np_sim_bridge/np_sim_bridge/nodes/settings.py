"""The parameters of a bridge, whatever the engine."""

from __future__ import annotations

from dataclasses import dataclass

from rclpy.node import Node

from np_description.domains import Task
from np_description.force_reflex import DEFAULT_MODE, MODES
from np_description.objects import scenarios
from np_ros.node import declare_mode, parameter
from np_ros.task_domain import declare_domain
from np_sim_bridge.renderer import RENDERERS

SHAPES, MESHES = LOOKS = "shapes", "meshes"


@dataclass(frozen=True)
class BridgeSettings:
    """Parameters of a bridge, as `declare` describes them."""

    domain: Task
    """Task family with its object."""
    seed: int
    """Of tasks and sensors."""
    first_episode: int
    """Number of the episode that the first reset draws."""
    scenario: int
    """Number of a fixed task; 0: tasks are drawn."""
    substeps: int
    """Physics steps a control period."""
    mode: str
    """lockstep or realtime."""
    policy_rate: int
    """Hz."""
    image_rate: int
    """Hz."""
    camera: bool
    """Whether images are published."""
    calibration: str
    """File of the camera's calibration; empty: as trained."""
    renderer: str
    """auto, egl or warp."""
    shadows: bool
    """Whether images have shadows."""
    look: str
    """Appearance of the scene."""
    tick_barrier: bool
    """Whether a tick waits for the nodes that reply to it."""
    timeout: float
    """Of a reply in lockstep, s of wall time."""
    priority: int
    """Of first-in-first-out scheduling; 0: none."""
    effects: str
    """Patch file of the arm and its view; empty: nominal."""
    force_reflex: str
    """stop or observe."""

    @property
    def lockstep(self) -> bool:
        """Whether time waits for the replies."""
        return self.mode == "lockstep"


def declare(node: Node) -> BridgeSettings:
    """Declare and read the parameters. Raises ValueError and ParameterException as `np_ros.node.parameter` does."""
    return BridgeSettings(
        declare_domain(node),
        parameter(node, "seed", 0, "With the episode's number it names the task.", 0, 2**31 - 1),
        parameter(node, "first_episode", 0, "Number of the episode that the first reset draws.", 0, 2**31 - 1),
        parameter(node, "scenario", 0, "Fixed task of every episode; 0: tasks are drawn.", 0, scenarios.COUNT),
        parameter(node, "substeps", 1, "Physics steps in a control period of 2 ms.", 1, 20),
        declare_mode(node),
        parameter(node, "policy_rate", 10, "Policy ticks a second; a divisor of 500.", 1, 500),
        parameter(node, "image_rate", 30, "Images a second; policy ticks have one in any case.", 1, 500),
        parameter(node, "camera", True, "Whether images are drawn."),
        parameter(node, "calibration", "", "File written by `calibrate`: where the camera is; empty: as trained."),
        parameter(
            node,
            "renderer",
            "auto",
            "What draws them: OpenGL (egl), a ray caster on the CPU (warp), or whichever works (auto).",
            choices=RENDERERS,
        ),
        parameter(node, "shadows", True, "Whether the arm casts a shadow in the images."),
        parameter(
            node,
            "arm_look",
            SHAPES,
            "The arm in the images: the shapes that collide, with which detectors are trained, or meshes (`make meshes`).",
            choices=LOOKS,
        ),
        parameter(node, "tick_barrier", True, "Lockstep: whether time waits for ticks and targets too."),
        parameter(
            node,
            "lockstep_timeout",
            120.0,
            "Lockstep: s of wall time that an answer may be missing before the arm is stopped.",
            1.0,
            3600.0,
        ),
        parameter(node, "realtime_priority", 0, "SCHED_FIFO priority; 0: none.", 0, 90),
        parameter(node, "effects", "", "Patch file of effects that the nominal arm and its camera lack."),
        parameter(
            node,
            "force_reflex",
            DEFAULT_MODE,
            "Above a threshold of external force: stop the arm as the robot does, or observe and count the stop.",
            choices=MODES,
        ),
    )
