"""Stand-ins for episodes and for processes, by which finetuning takes no time."""

from concurrent.futures import Future

from sim2real.effects.patch import Patch, PatchEffect

from np_evaluation.calibration_corrections import OF_DRIVER
from np_evaluation.finetune.rollouts import patch_of

FRICTION = PatchEffect("coulomb_friction", "panda_joint4", {"level": 2.0})
GRIP = PatchEffect("gripper_friction", "contact", {"relative": -0.4})
BOTH = Patch((FRICTION, GRIP))
WEIGHTS = {"weights": "new", "weights_old_student": "old"}


class Here:
    """An executor that does everything at once, in this process."""

    def submit(self, case, /, *arguments) -> Future:
        done = Future()
        done.set_result(case(*arguments))
        return done


def losing(chances):
    """In place of episodes: a tenth of them each, of ten, is lost to an effect that `chances` names, by its tenths."""

    def play(cell, numbers):
        told = {e.effect for e in patch_of(cell.corrected).effects if e.effect in OF_DRIVER}
        there = {e.effect for e in patch_of(cell.effects).effects} - told
        lost = {tenth for effect in there for tenth in chances.get(effect, ())}
        if cell.weights:  # what training brings back, and the new student spoils
            lost = {tenth for tenth in lost if tenth > 2} | ({9} if cell.weights.endswith("/new") else set())
        return [number % 10 not in lost for number in numbers]

    return play
