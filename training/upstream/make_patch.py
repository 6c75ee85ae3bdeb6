"""Writes fused_newton.patch: the fused contact solver as a change of MuJoCo Warp, from this project's own sources.

python training/upstream/make_patch.py > training/upstream/fused_newton.patch
"""

from __future__ import annotations

import ast
import difflib
import re
import sys
from pathlib import Path

from mujoco_warp._src import solver

from np_training.physics.fused_solver import kernel, solve

HEAD = '''"""Newton's method for all constraints of a world in one kernel.

The general solver launches about ten kernels an iteration, over all rows that a world has room for, until the slowest world has
converged. Here a warp takes one world through all its iterations in shared memory and leaves when that world has converged.
"""

from functools import cache

import warp as wp

from mujoco_warp._src import smooth
from mujoco_warp._src import types

'''
OLD = """  else:
    ctx = _create_solver_context(m, d, inplace_cholesky=True)
    _solve(m, d, ctx)
"""
NEW = (
    """  elif solver_fused.misfit(m, d) is None:
    solver_fused.solve(m, d)
"""
    + OLD
)
IMPORT = "from mujoco_warp._src import smooth\n"


def segments(path: Path, names: tuple[str, ...]) -> str:
    """The source of a module's definitions with these names, with the strings that describe constants, indented by two spaces."""
    text = path.read_text()
    lines, body, parts = text.splitlines(), ast.parse(text).body, []
    for node, after in zip(body, [*body[1:], None]):
        found = (
            {node.name}
            if isinstance(node, ast.FunctionDef)
            else {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}
        )
        if isinstance(node, (ast.FunctionDef, ast.Assign)) and found & set(names):
            first = min([node.lineno, *(d.lineno for d in getattr(node, "decorator_list", []))])
            described = isinstance(after, ast.Expr)
            gap = "\n\n" if isinstance(node, ast.FunctionDef) else ""
            parts.append(gap + "\n".join(lines[first - 1 : (after if described else node).end_lineno]))
    return re.sub(r"^( +)", lambda spaces: spaces[0][: len(spaces[0]) // 2], "\n".join(parts), flags=re.MULTILINE)


def write_fused_module(licence: str) -> str:
    """The text of the new module mujoco_warp/_src/solver_fused.py."""
    constants = segments(Path(solve.__file__), ("SIZES", "MOST_DOFS", "LANES"))
    native = f'SOURCE = r"""{kernel.SOURCE.read_text()}"""\n'
    arrays = segments(Path(kernel.__file__), ("Numbers", "Counts"))
    functions = segments(Path(kernel.__file__), ("newton_kernel",)).replace(
        'SOURCE.read_text(encoding="utf-8")', "SOURCE"
    )
    return "\n".join(
        [
            licence + HEAD + constants,
            arrays,
            native + functions,
            segments(Path(solve.__file__), ("misfit", "solve")),
            "",
        ]
    ).replace("mjw.", "types.")


def make_patch() -> str:
    """The patch, for `git apply` in a checkout of MuJoCo Warp."""
    before = Path(solver.__file__).read_text()
    if before.count(OLD) != 1 or before.count(IMPORT) != 1:
        raise ValueError("mujoco_warp: expected solver.py of 4.0.0, got another version")
    after = before.replace(OLD, NEW).replace(IMPORT, IMPORT + "from mujoco_warp._src import solver_fused\n")
    licence = before[: before.index("import dataclasses")]
    path, added = "mujoco_warp/_src/solver.py", "mujoco_warp/_src/solver_fused.py"
    changed = difflib.unified_diff(before.splitlines(True), after.splitlines(True), f"a/{path}", f"b/{path}")
    module = write_fused_module(licence).splitlines(True)
    new = difflib.unified_diff([], module, "/dev/null", f"b/{added}")
    return "".join([*changed, f"diff --git a/{added} b/{added}\nnew file mode 100644\n", *new])


if __name__ == "__main__":
    sys.stdout.write(make_patch())
