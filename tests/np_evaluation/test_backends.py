"""The launch argument `backend`: which nodes a graph has with the simulated robot, and with the real one."""

import pytest

from np_bringup.backends import ENGINES
from np_bringup.task_graph import LOOP_PRIORITY, check_and_build_graph, task_graph
from np_diagnosis.commands import excite
from np_diagnosis.commands.excite import make_graph
from np_evaluation.commands import evaluate
from np_evaluation.commands.bench import observer
from np_sim_bridge.simulators import SIMULATORS

REAL = {"backend": "franka_driver", "mode": "realtime", "hostname": "robot", "calibration": "camera.yaml"}


def named(arguments):
    """The nodes by name."""
    return {spec.name: spec for spec in task_graph(arguments)}


def test_the_driver_takes_the_place_of_the_bridge():
    simulated, real = named({"mode": "realtime"}), named(REAL)
    assert set(simulated) - set(real) == {"sim_bridge"}
    assert set(real) - set(simulated) == {"franka_driver", "realsense_camera"}
    assert real["franka_driver"].parameters["hostname"] == "robot"
    assert real["franka_driver"].parameters["robot"] == "fr3"
    assert named({**REAL, "robot": "panda"})["franka_driver"].parameters["robot"] == "panda"
    assert real["realsense_camera"].parameters["calibration"] == "camera.yaml"
    for nodes, backend in ((simulated, "sim_bridge"), (real, "franka_driver")):
        assert nodes["episode"].parameters["backend"] == backend


@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
def test_the_second_engine_stands_where_the_first_stood(mode):
    first, second = named({"mode": mode}), named({"mode": mode, "backend": "physx_bridge"})
    assert set(first) - set(second) == {"sim_bridge"} and set(second) - set(first) == {"physx_bridge"}
    assert second["physx_bridge"].package == "np_physx_bridge"
    assert second["physx_bridge"].parameters == first["sim_bridge"].parameters
    assert second["physx_bridge"].realtime == first["sim_bridge"].realtime
    assert second["episode"].parameters["backend"] == "physx_bridge"


@pytest.mark.parametrize("engine", SIMULATORS)
def test_an_engine_is_the_same_node_for_every_command(engine, tmp_path):
    """Episodes and excitation read one table."""
    wanted = SIMULATORS[engine]
    played = {(spec.package, spec.executable) for spec in task_graph({"backend": ENGINES[engine]})}
    excited = {(spec.package, spec.executable) for spec in make_graph(tmp_path / "bag", "lockstep", engine=engine)}
    assert (wanted.package, wanted.executable) in played & excited
    assert evaluate.parse(["--keypoints", "truth"]).engine == excite.parse(["--out", "bag"]).engine == "mujoco"


def test_with_the_controller_on_board_there_is_no_other():
    real = named({**REAL, "control": "onboard", "camera": "none"})
    assert real["franka_driver"].parameters["control"] == "onboard"
    assert "joint_impedance" not in real and "realsense_camera" not in real


OWN = {"backend": "none", "backend_node": "my_arm", "mode": "realtime"}


def test_beside_a_backend_of_ones_own_everything_else_is_started():
    simulated, own = named({"mode": "realtime"}), named(OWN)
    assert set(simulated) - set(own) == {"sim_bridge"} and not set(own) - set(simulated)
    assert own["episode"].parameters["backend"] == "my_arm"
    assert "joint_impedance" not in named({**OWN, "control": "onboard"})
    assert named({**OWN, "mode": "lockstep"})["joint_impedance"].parameters["mode"] == "lockstep"
    for arguments, got in (({**OWN, "backend_node": ""}, "''"), ({"backend_node": "my_arm"}, "'my_arm'")):
        with pytest.raises(ValueError, match=f"backend_node: expected .* got {got}"):
            task_graph(arguments)


def test_a_recorder_does_not_wait_for_what_only_a_simulation_knows():
    for arguments, known in (({"mode": "realtime"}, True), (REAL, False)):
        recorder = named({**arguments, "bag": "bag"})["recorder"]
        assert ("object_pose" in recorder.parameters["required"]) is known


@pytest.mark.parametrize(
    "changes, text",
    [
        ({"backend": "other"}, "backend: expected one of"),
        ({"mode": "lockstep"}, "mode: expected realtime"),
        ({"keypoints": "truth"}, "keypoints: expected camera"),
        ({"hostname": ""}, "hostname: expected one"),
        ({"robot": "ur5"}, "robot: expected one of fr3, panda"),
        ({"calibration": ""}, "calibration: expected one"),
        ({"calibration": "none"}, "calibration: expected one"),
        ({"control": "other"}, "control: expected one of"),
    ],
)
def test_what_does_not_go_together_is_named(changes, text):
    with pytest.raises(ValueError, match=text):
        task_graph({**REAL, **changes})


def test_in_real_time_neither_the_loop_nor_the_heartbeat_waits_for_slow_nodes():
    nodes = {node.name: node for node in task_graph({"mode": "realtime"})}
    loop, owner = {"sim_bridge", "joint_impedance"}, {"episode"}
    assert {name for name, node in nodes.items() if node.realtime} == loop | owner
    assert {node.realtime for name, node in nodes.items() if name in loop} == {LOOP_PRIORITY}
    assert 0 < nodes["episode"].realtime < LOOP_PRIORITY
    assert all(node.nice == 10 for name, node in nodes.items() if name not in loop | owner)


@pytest.mark.parametrize(
    "changes, text",
    [
        ({"domain": "mug"}, "domain: expected one of card, bump, wall, got 'mug'"),
        ({"scenario": "9"}, "scenario: expected one of 0 to 3, got 9"),
        ({"weights": "nowhere"}, "weights: expected a folder, got nowhere"),
        ({"effects": "nowhere.yaml"}, "effects nowhere.yaml: expected a patch.yaml"),
        ({"calibration": "nowhere.yaml"}, "calibration nowhere.yaml: expected a file written by `calibrate`"),
        ({"namespace": "lab"}, "namespace: expected one as /lab, got 'lab'"),
        ({"params_file": "nowhere.yaml"}, "params_file: expected a file, got 'nowhere.yaml'"),
    ],
)
def test_a_launch_with_a_wrong_file_or_choice_gives_no_nodes(changes, text):
    with pytest.raises(ValueError, match=text):
        check_and_build_graph(changes)


def test_who_measures_the_loop_waits_for_a_core_no_longer_than_the_backend(tmp_path):
    nodes = named({"mode": "realtime"})
    seen = observer(tmp_path, ("keypoints", "played/keypoints"))
    assert seen.realtime == nodes["sim_bridge"].realtime == nodes["joint_impedance"].realtime > 0
    assert seen.remappings == (("keypoints", "played/keypoints"),)
