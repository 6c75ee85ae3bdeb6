"""Timings of single parts, each beside a peer measured in the same run. No ROS."""

from __future__ import annotations

import time

import mujoco
import numpy as np

from np_common.timing import milliseconds
from np_description.domains import Pose, Task, sample_task
from np_description.panda import NOMINAL
from np_description.scene import load_model

PERIOD = 0.002  # s


def simulation_figures(domain: Task, periods: int = 5000) -> dict[str, object]:
    """Real-time factors of the bridge's simulation, guards included, and of bare mj_step."""
    from np_control.safety import SafetyFilter
    from np_sim_bridge.simulation import Simulation

    simulation, guard = Simulation(domain), SafetyFilter()
    measured = simulation.measure()
    guard.start(measured.position[:7])
    began = time.perf_counter()
    for _ in range(periods):
        applied = guard.apply(measured.stamp, measured.position[:7], measured.velocity[:7])
        simulation.step(applied.torque)
        measured = simulation.measure()
    ours = time.perf_counter() - began
    model = load_model(domain, timestep=PERIOD)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    began = time.perf_counter()
    for _ in range(periods):
        mujoco.mj_step(model, data)
    bare = time.perf_counter() - began
    return {
        "factor": round(periods * PERIOD / ours, 1),
        "peer": "mj_step of the same scene alone",
        "peer_factor": round(periods * PERIOD / bare, 1),
    }


def static_figures() -> dict[str, object]:
    """Contact of each engine that is installed beside rigid theory."""
    from np_physx_bridge import static_bench

    return static_bench.figures(static_bench.results())


def in_process_figures(domain: Task, weights: str) -> dict[str, object]:
    """An episode in one process, by engine: processor time of a control period, ticks and plan shared out, beside the engine's own step in it."""
    from np_evaluation.in_process import InProcessRollout
    from np_physx_bridge.library import missing

    figures: dict[str, object] = {}
    for name in ("mujoco", *([] if missing() else ["physx"])):
        played, spent = InProcessRollout(domain, name, weights=weights), []
        played.time_engine(spent.append)
        began = time.process_time()
        result = played.play(0)
        whole = time.process_time() - began
        figures[name] = {
            "success": result.success,
            "processor_s": round(whole, 2),
            "period_us": round(whole / len(spent) * 1e6),
            "peer": "the engine's step alone",
            "peer_period_us": round(sum(spent) / len(spent) * 1e6),
        }
    return figures


def renderer_figures(domain: Task) -> dict[str, object]:
    """One image by each way of drawing; they are each other's peers. None where a way does not work here."""
    from np_sim_bridge.renderer import egl_works, make_renderer

    model = load_model(domain)
    configuration = np.array(model.key_qpos[0])
    figures: dict[str, object] = {}
    for kind in ("egl", "warp"):
        if kind == "egl" and not egl_works():
            figures[kind] = None
            continue
        renderer = make_renderer(kind, model)
        figures[kind] = milliseconds(lambda: renderer.render(configuration), 30)
        renderer.close()
    return figures


def detector_figures(domain: Task, weights: str) -> dict[str, object]:
    """The detector as the node runs it."""
    from np_perception.detector import IMAGE_SHAPE, KeypointDetector

    detector, image = KeypointDetector(domain, weights), np.zeros(IMAGE_SHAPE, np.uint8)
    return milliseconds(lambda: detector.detect(image), 50)


def policy_figures(domain: Task, weights: str, repeats: int = 300) -> dict[str, object]:
    """One decision of the post-contact policy, observation to gains, against its bare torch module."""
    import torch

    from np_perception.pose_estimation import project_keypoints
    from np_policy.contract import POST_CONTACT, PolicyContract, weights_file
    from np_policy.networks import PostContactNetwork
    from np_policy.observation import POST_SIZE
    from np_policy.policy import PostContactPolicy
    from np_policy.weights import load

    torch.set_num_threads(1)
    file = weights_file(POST_CONTACT, domain, weights)
    controller = PostContactPolicy(file, domain)
    start, goal = sample_task(domain, np.random.default_rng(0))
    here, there = project_keypoints(domain, start), project_keypoints(domain, goal)
    q, dq = np.concatenate([NOMINAL.ready, np.zeros(2)]), np.zeros(9)
    figures = milliseconds(lambda: controller.act(q, dq, here, there), repeats)
    network, state = load(PostContactNetwork(), file, PolicyContract.of(POST_CONTACT, domain)), torch.zeros(POST_SIZE)

    def plain():
        with torch.inference_mode():
            network(state)

    peer = milliseconds(plain, repeats)
    return {**figures, "peer": "the torch module alone", **{f"peer_{k}": v for k, v in peer.items()}}


def planner_figures(domain: Task, tasks: int = 10) -> dict[str, object]:
    """Planning the approach to the object's top from random postures, against RRT-Connect alone."""
    from np_planning.approach import ApproachConfig, plan_approach
    from np_planning.collision import CollisionModel
    from np_planning.rrt import PlanningBudget, PlanningError

    collision = CollisionModel(domain)
    down = np.array([0.0, 1.0, 0.0, 0.0])  # the hand points at the table
    lower, upper = NOMINAL.position_lower + 0.1, NOMINAL.position_upper - 0.1

    def random_start(rng: np.random.Generator) -> np.ndarray:
        while True:
            joints = rng.uniform(lower, upper)
            if collision.is_free(joints):
                return joints

    def plan(budget: PlanningBudget) -> dict[str, object]:
        seconds, durations, failures = [], [], 0
        for seed in range(tasks):
            rng = np.random.default_rng(seed)
            start, _ = sample_task(domain, rng)
            wanted = Pose(start.position + [0.0, 0.0, domain.half_size[2] + 0.005], down)
            collision.place(start, 0.0)
            joints = random_start(rng)
            began = time.perf_counter()
            try:
                config = ApproachConfig(budget=budget)
                found = plan_approach(collision, joints, wanted, 0.0, start, seed=seed, config=config)
                durations.append(found.trajectory.duration)
            except PlanningError:
                failures += 1
            seconds.append(time.perf_counter() - began)
        return {
            "p50_s": round(float(np.median(seconds)), 3),
            "max_s": round(max(seconds), 3),
            "failures": failures,
            "motion_s": round(float(np.median(durations)), 2) if durations else None,
        }

    full, first = plan(PlanningBudget()), plan(PlanningBudget(improve=0))
    return {"tasks": tasks, **full, "peer": "RRT-Connect alone", **{f"peer_{k}": v for k, v in first.items()}}
