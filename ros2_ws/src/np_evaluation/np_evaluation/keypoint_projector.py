"""The camera and the detector of one process: where an episode without a graph sees its object in images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from sim2real.effects.camera_effects import CameraEffects
from sim2real.effects.patch import Patch

from np_description.camera import CAMERA
from np_description.domains import Task
from np_perception.detector import KeypointDetector
from np_sim_bridge.renderer import Renderer, make_renderer
from np_sim_bridge.simulation import Simulation
from np_sim_bridge.view import SceneView


class DetectedKeypoints:
    """Images of one scene, drawn as the graph's are, one episode after the other; only of ticks, as no others are used.

    domain, patch: of the scene; seed: of the view's scatter; weights: folder of the detector, "" for the project's own. Raises WeightsError
    where that does not fit.
    """

    def __init__(self, domain: Task, patch: Patch, seed: int, weights: str | Path = ""):
        self._patch, self._seed = patch, seed
        self._detector = KeypointDetector(domain, weights)
        self._renderer: Renderer | None = None  # of the scene of the first episode: all have the same
        self.begin()

    def begin(self) -> None:
        """An episode begins."""
        self._view = SceneView(CameraEffects(self._patch, CAMERA, self._seed))

    def look(self, arm: Simulation) -> None:
        """Once a control period: remember the scene where an image may show it later."""
        self._arm = arm
        self._view.keep(arm.stamp, arm.configuration)

    def seen(self, stamp: int) -> np.ndarray:
        """Keypoints (8, 3) u px, v px, score, that the detector finds in the image of `stamp` ns, which is now."""
        if self._renderer is None:
            self._renderer = make_renderer("auto", self._arm.model)
        pixels = self._renderer.render(self._view.scene(stamp, self._arm.configuration))
        return self._detector.detect(self._view.through_lens(pixels)).keypoints
