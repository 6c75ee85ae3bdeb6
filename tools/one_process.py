"""Episodes without a graph: simulated robot, guards, controller, planner, policies and the phases of an episode in one process, true corners.

    python tools/one_process.py --domains bump wall --engine physx --tries 5 --out FOLDER          # the paper's table
    python tools/one_process.py --domains bump --object cube.yaml --tries 24 [--alone]              # drawn tasks, one object

For many episodes on few cores: one takes 1 to 4 s of processor time, where eight nodes take 20 to 40. What the nodes call is called
in the same order, without messages, so that an episode is not the graph's bit for bit: contacts tell the last digit. --alone: the contact
is chosen as if the object had the size that the weights know. The last line printed is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch

from np_bringup.evaluation import Result, code_sha256, result_of, summary
from np_bringup.paper_table import OURS, Played, cells, episodes, rows, totals
from np_control.controller import Controller
from np_control.safety import Refusal, SafetyFilter
from np_description.camera import CAMERA
from np_description.domains import DOMAINS, Domain, find_domain
from np_description.objects.choice import DEFAULT, domain_with, portable
from np_description.panda import JOINT_NAMES
from np_description.phases import FAULT, POST, PRE, PhaseState
from np_perception.pose_estimation import PoseError, estimate_pose, project_keypoints
from np_policy.action import PolicyError
from np_policy.approach import plan_approach
from np_policy.collision import CollisionModel
from np_policy.contract import POST_CONTACT, PRE_CONTACT, weights_file
from np_policy.episode import SECOND, Episode, EpisodeConfig, Event
from np_policy.planning import PlanningError
from np_policy.policy import PostContactController, PreContactPlanner
from np_record.command import Progress, origin
from np_record.recorded_episode import score
from np_sim_bridge.mujoco_engine import MujocoEngine
from np_sim_bridge.simulation import Simulation

TICK = SECOND // 10


class OneProcess:
    """A domain's graph as one object. alone: contacts are chosen as if the object had the size that the weights know."""

    def __init__(self, domain: Domain, engine: str, *, seed: int = 0, contacts: int = 1, alone: bool = False):
        self._domain, self._seed, self._engine_name, self._contacts = domain, seed, engine, contacts
        self._engine = MujocoEngine
        if engine == "physx":
            from np_physx_bridge.engine import PhysxEngine

            self._engine = PhysxEngine
        chosen_for = find_domain(domain.name) if alone else domain
        self._pre = PreContactPlanner(weights_file(PRE_CONTACT, domain), chosen_for)
        self._post = PostContactController(weights_file(POST_CONTACT, domain), domain)
        self._collision = CollisionModel(domain)

    def play(self, number: int, scenario: int = 0) -> Result:
        """One episode."""
        began, said = time.monotonic(), []
        arm = Simulation(self._domain, seed=self._seed, first_episode=number, engine=self._engine, scenario=scenario)
        controller, guard = Controller(), SafetyFilter()
        guard.start(arm.measure().position[:7])
        config = EpisodeConfig(self._domain, contacts=self._contacts, success_share=self._domain.aim)
        episode = Episode(config, lambda: arm.measure().position[:7].copy())
        goal = project_keypoints(self._domain, arm.task.goal)
        _note(said, [*episode.start(), *episode.goal(0, arm.task.goal)])
        while True:
            now = arm.measure()
            q, dq = now.position[:7], now.velocity[:7]
            if not guard.watchdog.may_move:
                said.append(PhaseState(FAULT, guard.watchdog.cause))
                break
            controller.observe(now.stamp, q, dq)
            if now.stamp % TICK == 0:
                self._tick(arm, controller, episode, now, goal, said)
                if not episode.is_active:
                    break
            answer = controller.answer()
            guard.offer(now.stamp, JOINT_NAMES, answer.position, answer.velocity, answer.torque, now=now.stamp)
            arm.step(guard.apply(now.stamp, q, dq).torque)
        outcome = score(self._domain, said, arm.object_pose(), arm.task.goal, arm.stamp / SECOND)
        return result_of(number, outcome, time.monotonic() - began)

    def _tick(self, arm: Simulation, controller: Controller, episode: Episode, now, goal, said) -> None:
        seen = self._seen(arm)
        before = episode.phase
        _note(said, episode.keypoints(now.stamp, seen))
        if episode.phase == PRE and episode.awaits == "joint_trajectory":
            _note(said, self._approach(arm, controller, episode, now, seen, goal))
        elif episode.phase == PRE and before == POST:
            controller.hold()
        elif episode.phase == POST:
            if before != POST:
                self._post.reset()
            try:
                target = self._post.act(now.position, now.velocity, seen, goal)
                controller.set_target(
                    now.stamp, target.position, target.rotation, target.stiffness, target.damping_ratio
                )
            except (PolicyError, Refusal):
                pass  # as in the graph: the target before stays

    def _seen(self, arm: Simulation) -> np.ndarray:
        """The object's true corners (8, 3), usable where they lie in the image; none of an object that was thrown behind the camera."""
        try:
            seen = project_keypoints(self._domain, arm.object_pose())
        except ValueError:
            return np.zeros((8, 3))
        seen[:, 2] = ((seen[:, :2] > -0.5) & (seen[:, :2] < (CAMERA.width - 0.5, CAMERA.height - 0.5))).all(axis=1)
        return seen

    def _approach(self, arm: Simulation, controller: Controller, episode: Episode, now, seen, goal) -> list[Event]:
        try:
            wanted = self._pre.propose(seen, goal)
            objekt = estimate_pose(seen, self._domain).pose
            plan = plan_approach(
                self._collision, now.position[:7], wanted.pose, wanted.opening, objekt, seed=self._seed
            )
        except (PlanningError, PoseError, PolicyError) as error:
            return episode.refusal(now.stamp, str(error))
        arm.set_fingers(wanted.opening)
        controller.follow(plan.trajectory, now.stamp)
        return episode.trajectory(now.stamp, plan.trajectory.duration, plan.trajectory.positions[-1])


def _note(said: list[PhaseState], events: list[Event]) -> None:
    said += [event for event in events if isinstance(event, PhaseState)]


def main() -> None:
    """Play what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--domains", nargs="+", choices=list(DOMAINS), default=["bump", "wall"])
    parser.add_argument("--rows", nargs="+", default=[], help="rows of the table; default: all")
    parser.add_argument("--object", help="drawn tasks with this one, in place of the table")
    parser.add_argument("--engine", choices=("mujoco", "physx"), default="mujoco")
    parser.add_argument("--tries", type=int, default=5, help="episodes, of a cell in the table")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--contacts", type=int, default=1)
    parser.add_argument("--alone", action="store_true")
    parser.add_argument("--out", type=Path, help="file for the table")
    options = parser.parse_args()
    torch.set_num_threads(1)
    what = dict(seed=options.seed, contacts=options.contacts, alone=options.alone)
    if options.object:
        (name,) = options.domains
        text = options.object if options.object == DEFAULT else portable(name, options.object)
        played = OneProcess(domain_with(name, text), options.engine, **what)
        results = [played.play(number) for number in range(options.tries)]
        print(json.dumps({"domain": name, "object": text, "engine": options.engine, **what, **summary(results)}))
        return
    asked, began, finished = cells(options.domains, options.rows, [OURS]), time.monotonic(), []
    where = {"code_sha256": code_sha256(), **origin()}
    progress = Progress(len(asked), "table")
    for cell in asked:
        played = OneProcess(domain_with(cell.domain, cell.object), options.engine, **what)
        finished.append(Played(cell, tuple(played.play(n, cell.scenario) for n in range(options.tries))))
        progress.show(len(finished), f"success {sum(p.successes for p in finished)}")
        table = {
            "engine": options.engine,
            "keypoints": "truth",
            "graph": False,
            "contacts": options.contacts,
            "tries": options.tries,
            "seed": options.seed,
            **where,
            "totals": totals(finished),
            "rows": rows(finished),
            "per_episode": episodes(finished),
            "wall_s": round(time.monotonic() - began, 1),
        }
        if options.out:
            options.out.write_text(json.dumps(table, indent=1) + "\n")
    print(json.dumps(table["totals"]))


if __name__ == "__main__":
    main()
