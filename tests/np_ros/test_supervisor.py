"""The supervisor against real processes: ends, deaths, stubborn processes, domains."""

import multiprocessing
import os
import select
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from np_ros.processes.graph import LaunchArgument, NodeSpec, complete
from np_ros.processes.supervisor import NodeDied, Supervisor, find_installed_command, reserve_domain_id

SCRIPTS = {
    "patient": "import signal; print('up', flush=True); signal.pause()",
    "broken": "import sys; print('about to fail', file=sys.stderr); sys.exit('no weights at x')",
    "stubborn": "import signal; [signal.signal(s, signal.SIG_IGN) for s in (signal.SIGINT, signal.SIGTERM)]; "
    "print('up', flush=True)\nwhile True: signal.pause()",
}


def script(package, executable):
    return [sys.executable, "-c", SCRIPTS[executable]]


@pytest.fixture
def supervisor(tmp_path):
    with Supervisor(tmp_path, locate=script) as supervisor:
        yield supervisor


def is_up(supervisor, name):
    return lambda: supervisor.last_lines(name) == ["up"]


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_stop_ends_every_process(supervisor):
    supervisor.start([NodeSpec("p", "patient", "a"), NodeSpec("p", "patient", "b")])
    pids = [supervisor.pid("a"), supervisor.pid("b")]
    supervisor.wait(lambda: is_up(supervisor, "a")() and is_up(supervisor, "b")(), 20, "both nodes")
    supervisor.stop()
    assert not any(map(alive, pids)) and supervisor.names == []


# As a shell starts a command in the background, and nodes that have not got as far as their own handlers.
KILLED = """
import signal, sys
from np_ros.processes.graph import NodeSpec
from np_ros.processes.supervisor import Supervisor
signal.signal(signal.SIGINT, signal.SIG_IGN)
patient = lambda package, executable: [sys.executable, "-c", "import signal; print('up', flush=True); signal.pause()"]
supervisor = Supervisor(sys.argv[1], locate=patient)
supervisor.start([NodeSpec("p", "patient", "a"), NodeSpec("p", "patient", "b")])
supervisor.wait(lambda: all(supervisor.last_lines(name) == ["up"] for name in "ab"), 20, "both nodes")
print(supervisor.pid("a"), supervisor.pid("b"), flush=True)
signal.pause()
"""


def test_nodes_end_with_a_supervisor_that_is_killed(tmp_path):
    with subprocess.Popen([sys.executable, "-c", KILLED, tmp_path], stdout=subprocess.PIPE, text=True) as process:
        pids = [int(word) for word in process.stdout.readline().split()]
        handles = [os.pidfd_open(pid) for pid in pids]
        try:
            assert len(pids) == 2 and all(map(alive, pids))
            process.kill()
            ended = [select.select([handle], [], [], 20)[0] for handle in handles]
        finally:
            for handle in handles:
                try:
                    signal.pidfd_send_signal(handle, signal.SIGKILL)
                except ProcessLookupError:  # as it should be
                    pass
                os.close(handle)
    assert all(ended)


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGTERM])
def test_a_command_is_interrupted_by_a_closed_terminal_too(number):
    # Not signal.pause(): a signal that comes just before it is not waited for any more, and nothing ends it. Under nohup the tests'
    # children ignore a closed terminal, and so would the command.
    code = (
        "import signal, time; signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"
        "from np_common.cli import interrupt_on_sigterm; interrupt_on_sigterm()\n"
        "try:\n    print('up', flush=True)\n    while True: time.sleep(0.05)\nexcept KeyboardInterrupt:\n    print('ended')"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "up\n"
            process.send_signal(number)
            assert process.communicate(timeout=20)[0] == "ended\n"
        finally:
            process.kill()


def test_a_node_that_ends_is_reported_with_its_name_and_last_lines(supervisor):
    supervisor.start(NodeSpec("p", "broken", "detector"))
    with pytest.raises(NodeDied, match=r"(?s)detector ended with status 1.*about to fail.*no weights at x"):
        supervisor.wait(lambda: False, 20, "nothing")


def test_a_node_that_ignores_signals_is_killed(supervisor, monkeypatch):
    monkeypatch.setattr(
        "np_ros.processes.supervisor.STOP_SEQUENCE",
        ((signal.SIGINT, 0.2), (signal.SIGTERM, 0.2), (signal.SIGKILL, 10.0)),
    )
    supervisor.start(NodeSpec("p", "stubborn"))
    supervisor.wait(is_up(supervisor, "stubborn"), 20, "the node")
    pid = supervisor.pid("stubborn")
    supervisor.stop()
    assert not alive(pid)


def test_waiting_names_what_did_not_come(supervisor):
    with pytest.raises(TimeoutError, match="expected the keypoints within 0.1 s"):
        supervisor.wait(lambda: False, 0.1, "the keypoints")


def test_two_supervisors_use_different_domains():
    first, handle_first = reserve_domain_id()
    second, handle_second = reserve_domain_id()
    with handle_first, handle_second:
        assert first != second


def test_a_lock_that_cannot_be_opened_is_another_users(tmp_path):
    (tmp_path / "np_ros_domain_1.lock").symlink_to(tmp_path / "nowhere")  # root may read everything but this
    second, handle = reserve_domain_id(tmp_path)
    with handle:
        assert second == 2
    for number in range(1, 102):
        (tmp_path / f"np_ros_domain_{number}.lock").unlink(missing_ok=True)
        (tmp_path / f"np_ros_domain_{number}.lock").symlink_to(tmp_path / "nowhere")
    with pytest.raises(RuntimeError, match="no free ROS domain id"):
        reserve_domain_id(tmp_path)


NOBODY = 65534


def reserve_as(user, folder, pipe):
    """In a process of its own: who it becomes stays that."""
    try:
        os.setgroups([])
        os.setgid(user)
        os.setuid(user)
        pipe.send(reserve_domain_id(folder)[0])
    except Exception as error:
        pipe.send(repr(error))


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be two users")
@pytest.mark.parametrize("umask", [0o022, 0o077])
def test_two_users_use_different_domains(umask):
    context = multiprocessing.get_context("fork")  # nobody may not be allowed to read this interpreter's files

    def as_nobody():
        receiving, sending = context.Pipe(duplex=False)
        process = context.Process(target=reserve_as, args=(NOBODY, folder, sending))
        process.start()
        try:
            return receiving.recv() if receiving.poll(30) else "no answer"
        finally:
            process.join()

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o1777)
        before = os.umask(umask)
        try:
            ours, handle = reserve_domain_id(folder)
        finally:
            os.umask(before)
        with handle:
            assert (ours, as_nobody()) == (1, 2)
        assert as_nobody() == 1
        assert (folder / "np_ros_domain_2.lock").stat().st_uid == NOBODY
        again, handle = reserve_domain_id(folder)
        with handle:
            further, other = reserve_domain_id(folder)  # whose file is nobody's
            with other:
                assert (again, further) == (1, 2)


def test_an_executable_that_is_not_installed_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    with pytest.raises(LookupError, match="np_policy/post_contact"):
        find_installed_command("np_policy", "post_contact")


def test_a_node_has_its_namespace_and_the_users_parameters_come_last(supervisor, tmp_path):
    spec = NodeSpec("p", "patient", "a", {"x": 1}, namespace="/lab", params_file="own.yaml")
    own = str(tmp_path / "a.yaml")
    given = supervisor._ros_arguments(spec)
    assert given[:3] == ["--ros-args", "-r", "__node:=a"] and "__ns:=/lab" in given
    assert [given[n + 1] for n, each in enumerate(given) if each == "--params-file"] == [own, "own.yaml"]


def test_launch_arguments_are_completed_and_checked():
    known = [LaunchArgument("domain", "card", "task"), LaunchArgument("seed", "0", "seed")]
    assert complete({"seed": 3}, known) == {"domain": "card", "seed": "3"}
    with pytest.raises(ValueError, match="sed: expected one of domain, seed"):
        complete({"sed": "3"}, known)
