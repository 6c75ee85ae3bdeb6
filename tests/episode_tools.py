"""Episodes of the card in a given phase, without ROS, and the phases and ticks among their events."""

import numpy as np

from np_description.domains import CARD, sample_task
from np_description.phases import PhaseState
from np_perception.pose_estimation import project_keypoints
from np_policy.episode import Episode, Tick
from np_policy.episode_config import EpisodeConfig

TICK = 100_000_000
START, GOAL = sample_task(CARD, np.random.default_rng(0))


def keypoints(pose=START, score=1.0):
    points = project_keypoints(CARD, pose)
    points[:, 2] = score
    return points


BLIND = keypoints(score=0.0)


def make(**options):
    return Episode(EpisodeConfig(CARD, **options))


def phases(events):
    return [str(event) for event in events if isinstance(event, PhaseState)]


def ticks(events):
    return [(event.stamp // TICK, event.phase) for event in events if isinstance(event, Tick)]


def in_pre(**options):
    """An episode in phase pre, with a goal and without keypoints."""
    episode = make(**options)
    episode.goal(TICK, GOAL)
    episode.start()
    return episode


def in_approach(duration=0.2, **options):
    """An episode whose trajectory starts at tick 1 and, with settling, ends after duration + 0.3 s."""
    episode = in_pre(**options)
    episode.keypoints(TICK, keypoints())
    episode.trajectory(TICK, duration)
    return episode


def in_post(**options):
    """An episode in phase post since tick 6."""
    episode = in_approach(**options)
    for i in range(2, 7):
        episode.keypoints(i * TICK, keypoints())
    assert episode.phase == "post"
    return episode
