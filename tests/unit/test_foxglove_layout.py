"""The Foxglove layout beside Foxglove's own SDK, which knows the settings of every panel (pip install foxglove-sdk==0.30.3)."""

import json
from pathlib import Path

import pytest

panels = pytest.importorskip("foxglove.layouts", reason="pip install foxglove-sdk")

LAYOUT = Path(__file__).resolve().parents[2] / "ros2_ws/src/np_bringup/config/episode.foxglove.json"
KINDS = {
    "3D": panels.ThreeDeeConfig,
    "Image": panels.ImageConfig,
    "StateTransitions": panels.StateTransitionsConfig,
    "Plot": panels.PlotConfig,
    "DiagnosticSummary": panels.DiagnosticsSummaryConfig,
}
TOPICS = {
    "/scene_markers": panels.BaseRendererRosMarkerTopicSettings,
    "/target_pose": panels.BaseRendererPoseTopicSettings,
    "/robot_description": panels.BaseRendererUrdfTopicSettings,
}


def check(settings, kind, **needed):
    """That a kind of settings has all these by name."""
    unknown = set(settings) - set(kind(**needed)._to_dict())
    assert not unknown, f"{kind.__name__}: {unknown}"


def test_every_setting_of_the_layout_is_one_that_foxglove_has():
    for name, config in json.loads(LAYOUT.read_text())["configById"].items():
        check(config, KINDS[name.partition("!")[0]])
        check(config.get("imageMode", {}), panels.ImageModeConfig)
        check(config.get("cameraState", {}), panels.ThreeDeeCameraState)
        for topic, settings in config.get("topics", {}).items():
            check(settings, TOPICS[topic])
        for layer in config.get("layers", {}).values():
            check(layer, panels.BaseRendererGridLayerSettings)
        series = panels.PlotSeries if name.startswith("Plot") else panels.StateTransitionsSeries
        for path in config.get("paths", ()):
            check(path, series, value="/topic.field")
