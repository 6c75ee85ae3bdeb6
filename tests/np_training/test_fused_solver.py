"""The contact solver in one kernel against MuJoCo in C, against the library's solver, and what it refuses."""

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import torch
import warp as wp
from mujoco_warp._src import solver as library
from newton_reference import dense, primal

from np_description.domains import CARD, WALL
from np_training.bench.solver_rows import device_data, solve_in_c
from np_training.physics.batched import OBJECT_POSITION, BatchedPhysics
from np_training.physics.config import physics_for
from np_training.physics.fused_solver import choose_step, misfit, step_fused
from np_training.physics.fused_solver.solve import SIZES, solve

DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="needs CUDA"))]
WORLDS, PERIODS = 6, 2


@pytest.fixture(scope="module", params=[CARD, WALL], ids=lambda domain: domain.name)
def visited(request):
    """Model, and states of objects that lie, slide, turn and are pressed by a moving hand."""
    physics = BatchedPhysics(request.param, WORLDS, "cpu", physics_for("growing"))
    generator, states = torch.Generator().manual_seed(0), []
    data = mujoco.MjData(physics.host_model)
    mujoco.mj_resetDataKeyframe(physics.host_model, data, 0)
    mujoco.mj_forward(physics.host_model, data)
    hand = torch.tensor(data.site(0).xpos, dtype=torch.float)
    half = physics.host_model.geom("object").size[2]
    for world in range(WORLDS):
        pressed = world % 2 == 0
        where = hand - torch.tensor([0, 0, 1.02 * half]) if pressed else torch.tensor([0.5, 0.1, half - 1e-4])
        physics.qpos[world, OBJECT_POSITION] = where.float()
    physics.qvel[:, 9:11] = torch.rand(WORLDS, 2, generator=generator) - 0.5
    physics.qvel[:, 14] = 6 * torch.rand(WORLDS, generator=generator) - 3
    physics.noise[:] = 12 * torch.rand(WORLDS, 7, generator=generator) - 6

    def keep():
        d = physics.data
        states.append({name: getattr(d, name).numpy().copy() for name in ("qpos", "qvel", "qacc_warmstart", "ctrl")})

    step = physics._solve_step
    physics._solve_step = lambda m, d: (keep(), step(m, d))
    for _ in range(PERIODS):
        physics.advance()
    states = states[:: len(states) // 12]
    return physics.host_model, {name: np.concatenate([s[name] for s in states]) for name in states[0]}


def solve_on(device, method, model, rows, iterations=100, tolerance=1e-6):
    """Data after a method solved the rows with at most these iterations."""
    with wp.ScopedDevice(device):
        m, d = mjw.put_model(model), device_data(model, rows)
        m.opt.iterations, m.opt.ls_iterations, m.opt.warn_overflow = iterations, 50, 0
        m.opt.tolerance = wp.array([tolerance], dtype=float)
        method(m, d)
    return d


@pytest.fixture(scope="module")
def solved(visited):
    rows = solve_in_c(*visited)
    sliding = sum((s.states == int(mujoco.mjtConstraintState.mjCNSTRSTATE_CONE)).any() for s in rows)
    assert sliding > 5 and max(len(s.addresses) for s in rows) >= 4, "the states have to slide and touch"
    return rows


def test_the_reference_has_its_minimum_where_mujoco_has_it(visited, solved):
    model, _ = visited
    for rows in solved:
        _, gradient, hessian = primal(model, rows, rows.acceleration)
        left = gradient @ np.linalg.solve(hessian, gradient)
        assert left / np.trace(hessian) < 1e-10
        assert np.linalg.eigvalsh(hessian)[0] > 0


def test_gradient_and_hessian_of_the_reference_are_derivatives(visited, solved):
    model, _ = visited
    rng = np.random.default_rng(0)
    for rows in solved[::7]:
        a = rows.acceleration + rng.normal(size=model.nv)
        way, step = rng.normal(size=model.nv), 1e-6
        (more, up, _), (less, down, _) = (primal(model, rows, a + sign * step * way) for sign in (1, -1))
        _, gradient, hessian = primal(model, rows, a)
        assert (more - less) / (2 * step) == pytest.approx(gradient @ way, rel=1e-4)
        assert (up - down) / (2 * step) == pytest.approx(
            hessian @ way, rel=1e-3, abs=1e-3 * np.abs(hessian @ way).max()
        )


@pytest.mark.parametrize("device", DEVICES)
def test_the_kernel_finds_the_solution_of_mujoco_in_c(visited, solved, device):
    model, _ = visited
    d = solve_on(device, solve, model, solved, tolerance=1e-9)
    found, forces, pulls, states = (a.numpy() for a in (d.qacc, d.efc.force, d.qfrc_constraint, d.efc.state))
    for k, rows in enumerate(solved):
        pull = rows.jacobian.T @ rows.force
        for mine, right in ((found, rows.acceleration), (forces, rows.force), (pulls, pull)):
            assert mine[k, : len(right)] == pytest.approx(right, abs=5e-3 * max(1.0, np.abs(right).max()))
        # The states say how the forces come about.
        state, force = states[k, : len(rows.force)], forces[k, : len(rows.force)]
        names, size = mujoco.mjtConstraintState, max(1.0, np.abs(rows.force).max())
        assert not force[state == int(names.mjCNSTRSTATE_SATISFIED)].any()
        for sign, name in ((1, names.mjCNSTRSTATE_LINEARNEG), (-1, names.mjCNSTRSTATE_LINEARPOS)):
            assert force[state == int(name)] == pytest.approx(sign * rows.loss[state == int(name)])
        stiff = state == int(names.mjCNSTRSTATE_QUADRATIC)
        wanted = -rows.stiffness * (rows.jacobian @ rows.acceleration - rows.wanted)
        assert force[stiff] == pytest.approx(wanted[stiff], abs=1e-2 * size)
    assert not d.overflow.numpy().any()


@pytest.mark.parametrize("device", DEVICES)
def test_the_cost_that_is_left_is_what_the_tolerance_allows(visited, solved, device):
    model, _ = visited
    found = solve_on(device, solve, model, solved).qacc.numpy()
    for k, rows in enumerate(solved):
        best, most = primal(model, rows, rows.acceleration)[0], primal(model, rows, found[k].astype(float))[0]
        assert (most - best) / np.trace(dense(model, rows.inertia)) < 2e-6


@pytest.mark.parametrize("device", DEVICES)
def test_one_iteration_is_a_newton_step_with_an_exact_line_search(visited, solved, device):
    model, _ = visited
    d = solve_on(device, solve, model, solved, iterations=1)
    found, taken, short, stepped = d.qacc.numpy(), d.solver_niter.numpy(), d.overflow.numpy(), 0
    for k, rows in enumerate(solved):
        assert taken[k] <= 1
        _, gradient, hessian = primal(model, rows, rows.start.astype(float))
        search = -np.linalg.solve(hessian, gradient)
        way = found[k] - rows.start
        if not short[k]:
            continue
        stepped += 1
        assert way @ search / (np.linalg.norm(way) * np.linalg.norm(search)) > 0.999
        assert abs(primal(model, rows, rows.start + way)[1] @ search) < 0.02 * abs(gradient @ search)
    assert stepped > 5


@pytest.mark.parametrize("device", DEVICES)
def test_every_world_is_solved_by_the_kernel_for_its_number_of_rows(visited, solved, device, monkeypatch):
    model, _ = visited
    whole = solve_on(device, solve, model, solved).qacc.numpy()
    monkeypatch.setattr("np_training.physics.fused_solver.solve.SIZES", (8, 19, 24, SIZES[-1]))
    assert solve_on(device, solve, model, solved).qacc.numpy() == pytest.approx(whole, rel=1e-4, abs=1e-3)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("iterations", (2, 100))
def test_kernel_and_library_agree(visited, solved, device, iterations):
    model, _ = visited
    ours, librarys = (solve_on(device, method, model, solved, iterations, 1e-9) for method in (solve, library.solve))
    for name in ("qacc", "qfrc_constraint"):
        mine, right = getattr(ours, name).numpy(), getattr(librarys, name).numpy()
        error = np.abs(mine - right).max(1) / np.maximum(1.0, np.abs(right).max(1))
        assert np.quantile(error, 0.9) < 1e-3 and error.max() < (1e-2 if iterations > 50 else 5e-2)
    mine, right = ours.efc.Ma.numpy()[:, : model.nv], librarys.efc.Ma.numpy()[:, : model.nv]
    assert mine == pytest.approx(right, abs=2e-3 * float(np.abs(right).max()))
    assert np.abs(ours.solver_niter.numpy() - librarys.solver_niter.numpy()).mean() < 0.2
    for k, rows in enumerate(solved):
        known = slice(0, len(rows.force))
        assert (ours.efc.state.numpy()[k, known] == librarys.efc.state.numpy()[k, known]).mean() > 0.8


def test_a_scene_that_does_not_fit_is_stepped_by_the_library_and_the_log_says_why(caplog):
    physics = BatchedPhysics(CARD, 1, "cpu", physics_for("growing", constraints=SIZES[-1] + 1))
    assert physics._solve_step is mjw.step
    (line,) = [record.getMessage() for record in caplog.records]
    assert f"expected room for at most {SIZES[-1]} constraints, got {SIZES[-1] + 1}" in line
    fitting = BatchedPhysics(CARD, 1, "cpu", physics_for("growing"))
    assert misfit(fitting.model, fitting.data) is None
    assert fitting._solve_step is step_fused
    assert choose_step(fitting.model, fitting.data, fused=False) is mjw.step


def test_a_step_leaves_the_librarys_solver_in_its_place():
    physics, before = BatchedPhysics(CARD, 1, "cpu", physics_for("growing")), library.solve
    physics.advance()
    assert library.solve is before
