"""Every number by which a diagnosis decides, with its unit and meaning.

`THRESHOLDS` is the one set in use.
"""

from __future__ import annotations

from dataclasses import dataclass

from sim2real.thresholds import camera, checks, consequences, inference, keypoints, task, wiring

__all__ = ["THRESHOLDS", "Thresholds"]


@dataclass(frozen=True)
class Thresholds:
    """All thresholds, in the order in which a recording meets them; those of the chain beside the arm come last."""

    recordings: checks.Recordings = checks.Recordings()
    wiring: wiring.Wiring = wiring.Wiring()
    control_loop: checks.ControlLoop = checks.ControlLoop()
    plausibility: checks.Plausibility = checks.Plausibility()
    effort: checks.Effort = checks.Effort()
    current: checks.Current = checks.Current()
    rows: inference.Rows = inference.Rows()
    hints: inference.Hints = inference.Hints()
    blocks: inference.Blocks = inference.Blocks()
    nuisances: inference.Nuisances = inference.Nuisances()
    loop_delay: inference.LoopDelay = inference.LoopDelay()
    search: inference.Searching = inference.Searching()
    visible: inference.Visible = inference.Visible()
    ranking: inference.Ranking = inference.Ranking()
    estimates: inference.Estimating = inference.Estimating()
    omnibus: checks.Omnibus = checks.Omnibus()
    constancy: checks.Constancy = checks.Constancy()
    standstill: checks.Standstill = checks.Standstill()
    verdict: checks.Verdict = checks.Verdict()
    floor: checks.Floor = checks.Floor()
    held_out: checks.HeldOutMotion = checks.HeldOutMotion()
    shrinkage: checks.Shrinkage = checks.Shrinkage()
    ambiguity: consequences.AmbiguityThresholds = consequences.AmbiguityThresholds()
    power: consequences.Power = consequences.Power()
    simulation: consequences.Simulating = consequences.Simulating()
    patching: consequences.Patching = consequences.Patching()
    refit: consequences.Refitting = consequences.Refitting()
    keypoint_track: keypoints.KeypointTracking = keypoints.KeypointTracking()
    keypoint_noise: keypoints.KeypointScatter = keypoints.KeypointScatter()
    rest_poses: camera.RestPoses = camera.RestPoses()
    camera_spreads: camera.CameraSpreads = camera.CameraSpreads()
    camera_fit: camera.CameraFitting = camera.CameraFitting()
    camera_comparison: camera.CameraComparison = camera.CameraComparison()
    tip_force: task.TipForce = task.TipForce()
    surface_contact: task.SurfaceContact = task.SurfaceContact()
    friction_and_mass: task.FrictionAndMass = task.FrictionAndMass()
    image_latency: task.LatencyEstimate = task.LatencyEstimate()
    hand_eye_offset: task.HandEye = task.HandEye()
    tap_slides: task.TapSlides = task.TapSlides()
    object_motion: task.ObjectMotion = task.ObjectMotion()
    static_scene: task.StaticScene = task.StaticScene()
    occlusion: task.Occlusion = task.Occlusion()
    hypotheses: task.Hypotheses = task.Hypotheses()


THRESHOLDS = Thresholds()
