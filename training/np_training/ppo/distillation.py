"""The pre-contact policy distilled into the student that takes keypoints."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import torch

from np_common.rotations import quaternion_from_matrix, rotation_angle
from np_description.domains import Task
from np_description.hand import HandShapes
from np_description.objects.choice import DEFAULT, object_reference
from np_policy import hand_pose
from np_policy.contract import POST_CONTACT, PRE_CONTACT, PolicyContract
from np_policy.networks import PostContactNetwork, PreContactNetwork
from np_policy.observation import normalise_keypoints, student_observation
from np_policy.size_generalization import (
    SIZES,
    canonical_object_position,
    find_trained_domain,
    transfer_contact_position,
)
from np_policy.weights import load, save
from np_training.checkpoints import read_state
from np_training.contracts import make_trained_contract
from np_training.environment import contact
from np_training.environment.object_poses import canonical_poses, corners, pre_contact_state
from np_training.environment.view import BatchedView
from np_training.physics.config import physics_for
from np_training.ppo.networks import PreContactActor
from np_training.ppo.whitening import Whitening
from np_training.setting import chosen, domain_of, setting_of
from np_training.tasks.poses import Poses
from np_training.tasks.practice import draw_tasks
from np_training.tasks.registry import find_task

KEYPOINT_NOISE = 0.02  # largest standard deviation, normalised image units; 1.0 is half an image
POOL, REUSE = 32, 8  # batches of tasks kept, and updates from them for each that is new: the teacher is the slow part


def student_input(
    domain: Task,
    objects: Poses,
    goals: Poses,
    noise: torch.Tensor | float = 0.0,
    view: BatchedView = BatchedView(),
) -> torch.Tensor:
    """The student's input (n, 32) for tasks seen by `view`, keypoints disturbed by Gaussian noise of a standard deviation (n, 1, 1)."""
    return noisy_observation(*_keypoints(domain, objects, goals, view), noise)


@dataclass(frozen=True)
class Student:
    """A student's network, the object that it was trained with, as np_description.objects.choice names it, and from what to what factor of
    its edges."""

    network: PreContactNetwork
    object: str = DEFAULT
    sizes: tuple[float, float] = (1.0, 1.0)

    def hand_poses(
        self,
        domain: Task,
        objects: Poses,
        goals: Poses,
        noise: torch.Tensor | float = 0.0,
        view: BatchedView = BatchedView(),
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """T_E position (n, 3) m, rotation (n, 3, 3) and opening (n,) m that it chooses for tasks, as the node does: for an object of
        another size than those trained with, see np_policy.size_generalization. noise: of keypoints, a standard deviation (n, 1, 1); view: by which objects are seen."""
        known = find_trained_domain(domain, self.object, self.sizes)
        if known is None:
            return hand_pose.decode(self.network(student_input(domain, objects, goals, noise, view)))
        shown = (
            Poses(canonical_object_position(domain, known, poses.position, poses.quaternion), poses.quaternion)
            for poses in (objects, goals)
        )
        hand, rotation, opening = hand_pose.decode(self.network(student_input(known, *shown, noise, view)))
        there = transfer_contact_position(domain, known, objects.position, objects.quaternion, hand, rotation, opening)
        return there, rotation, opening


def noisy_observation(keypoints: torch.Tensor, goal: torch.Tensor, noise: torch.Tensor | float) -> torch.Tensor:
    """The student's input (n, 32) for keypoints (n, 8, 2), seen with noise of a standard deviation (n, 1, 1),
    and goal keypoints (n, 8, 2)."""
    return student_observation(keypoints + noise * torch.randn_like(keypoints), goal)


def shares_with(domain: Task, practice: float) -> tuple[float, ...]:
    """Share of each kind of the domain's tasks where `practice` of them are the kinds of its practice that sink no obstacle: objects
    also lie where none begins, as they do for a second contact. A domain without such practice has its own tasks alone."""
    kinds = find_task(domain.name).kinds
    whole = [number > 0 and not any(kind.lowered) for number, kind in enumerate(kinds)]
    practice = practice if any(whole) else 0.0
    return (1 - practice, *(practice * w / max(sum(whole), 1) for w in whole[1:]))


def _keypoints(domain: Task, objects: Poses, goals: Poses, view: BatchedView) -> tuple[torch.Tensor, torch.Tensor]:
    seen, wanted = (corners(domain, poses) for poses in canonical_poses(domain, objects, goals))
    return view.keypoints(seen, is_first=True), normalise_keypoints(wanted)


def distil(
    domain: Task,
    teacher: PreContactActor,
    device: str,
    minutes: float,
    batch: int,
    seed: int = 0,
    steps: int | None = None,
    hand: HandShapes | None = None,
    practice: float = 0.0,
    view: BatchedView = BatchedView(),
    begin_with: Path | None = None,
    sizes: tuple[float, float] = (1.0, 1.0),
) -> tuple[PreContactNetwork, dict[str, float]]:
    """Train a student for some minutes, or for so many steps, of a teacher that has `hand`; returns it with its errors on fresh
    noiseless tasks of the domain's own: means (mm, rad, mm) and the angle's median, which a teacher that decides between two faces leaves
    far below the mean. practice: share of tasks that are practice's (`shares_with`); view: by which objects are seen; begin_with: weights of a
    student that is taught on; sizes: range of the factor of the objects' edges."""
    generator = torch.Generator(device=device).manual_seed(seed)
    torch.manual_seed(seed)
    student = PreContactNetwork()
    if begin_with is not None:
        load(student, begin_with, PolicyContract.of(PRE_CONTACT, domain))
    student = student.to(device)

    def sample(shares: tuple[float, ...]) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Keypoints, goal keypoints and the teacher's actions, of a batch of fresh tasks."""
        tasks = draw_tasks(domain, shares, batch, generator, sizes)
        objects, goals = tasks.starts, tasks.goals
        with torch.no_grad():
            chosen = teacher(pre_contact_state(*canonical_poses(domain, objects, goals)))
            target = hand_pose.encode(*contact.contact_pose(domain, chosen, objects, hand))
        return *_keypoints(domain, objects, goals, view), target

    begin, step, share = time.monotonic(), 0, 0.0
    learned, own = shares_with(domain, practice), shares_with(domain, 0.0)
    pool = [torch.cat(parts) for parts in zip(*(sample(learned) for _ in range(POOL)))]
    # Differences below the noise's root mean square, over levels from 0 to the largest, carry no information.
    whiten = Whitening.of(student_observation(*pool[:2]), KEYPOINT_NOISE / 3**0.5)
    if begin_with is not None:
        whiten.take_from(student.net[0])
    optimiser = torch.optim.Adam(student.parameters())
    while share < 1:
        share = (step + 1) / steps if steps else (time.monotonic() - begin) / (60 * minutes)
        for group in optimiser.param_groups:
            group["lr"] = 1e-3 * max(1 - share, 1e-3)
        if step % REUSE == 0:
            oldest = step // REUSE % POOL * batch
            for tensor, part in zip(pool, sample(learned)):
                tensor[oldest : oldest + batch] = part
        rows = torch.randint(POOL * batch, (batch,), generator=generator, device=device)
        keypoints, goal, target = (tensor[rows] for tensor in pool)
        levels = KEYPOINT_NOISE * torch.rand(batch, 1, 1, generator=generator, device=device)
        loss = (student(whiten(noisy_observation(keypoints, goal, levels))) - target).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        step += 1
        if step % 500 == 0:
            print(f"step {step}  loss {loss.item():.2e}  left {minutes * (1 - share):.1f} min", flush=True)
    whiten.put_before(student.net[0])
    with torch.no_grad():
        keypoints, goal, target = sample(own)
        p, r, w = hand_pose.decode(student(student_observation(keypoints, goal)))
        tp, tr, tw = hand_pose.decode(target)
        angle = rotation_angle(quaternion_from_matrix(r), quaternion_from_matrix(tr))
        errors = {
            "position_mm": 1e3 * (p - tp).norm(dim=-1).mean().item(),
            "angle_rad": angle.mean().item(),
            "median_angle_rad": angle.median().item(),
            "width_mm": 1e3 * (w - tw).abs().mean().item(),
        }
    return student.cpu(), {"steps": step, **errors}


def distil_checkpoint(arguments: argparse.Namespace, refuse: Callable[[str], NoReturn]) -> dict:
    """Distil the checkpoint that the command line names; returns the content of its last line. refuse: called with a line on an object that the
    domain has not."""
    state = read_state(arguments.checkpoint, arguments.device)
    setting = setting_of(state)
    try:
        domain = domain_of(chosen(setting, domain=arguments.domain, object=arguments.object))
    except ValueError as error:
        refuse(str(error))
    teacher = PreContactActor().to(arguments.device)
    teacher.load_state_dict({name[4:]: tensor for name, tensor in state["networks"].items() if name.startswith("pre.")})
    student, figures = distil(
        domain,
        teacher,
        arguments.device,
        arguments.minutes,
        arguments.batch,
        arguments.seed,
        arguments.steps,
        physics_for(setting["contact"]).contact.hand,
        arguments.practice,
        BatchedView(arguments.effects),
        arguments.begin,
        arguments.sizes,
    )
    arguments.out.mkdir(parents=True, exist_ok=True)
    path = arguments.out / f"pre_contact_student_{domain.name}.safetensors"
    played = {"domain": domain.name, "object": object_reference(domain)}
    if arguments.sizes != (1.0, 1.0):
        played[SIZES] = "{:g} {:g}".format(*arguments.sizes)
    save(student, path, make_trained_contract(PRE_CONTACT, domain, damping_floor=setting["damping_floor"]), played)
    if arguments.weights is not None:
        post = PostContactNetwork()
        post.load_state_dict({name[5:]: t for name, t in state["networks"].items() if name.startswith("post.")})
        arguments.weights.mkdir(parents=True, exist_ok=True)
        for kind, network in ((PRE_CONTACT, student), (POST_CONTACT, post)):
            file = arguments.weights / f"{kind}_{domain.name}.safetensors"
            save(network, file, make_trained_contract(kind, domain, damping_floor=setting["damping_floor"]), played)
    return {"file": str(path), **played, "practice": arguments.practice, **figures}
