"""Small faults in Python code: each mutant changes one expression or statement of a module."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass

COMPARISONS = {
    ast.Lt: (ast.LtE, ast.Gt), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.Lt), ast.GtE: (ast.Gt, ast.Lt), ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,), ast.In: (ast.NotIn,), ast.NotIn: (ast.In,),
}  # fmt: skip
OPERATORS = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
}
NAMES = {
    "min": "max",
    "max": "min",
    "minimum": "maximum",
    "maximum": "minimum",
    "any": "all",
    "all": "any",
    "argmin": "argmax",
    "argmax": "argmin",
}
TRANSPARENT = ("clip", "_clip", "abs", "sqrt")  # calls that are replaced by their first argument


@dataclass(frozen=True)
class Mutant:
    """One change: `number` among those of its module, lines of the statement, its text, the expression before and after."""

    module: str
    number: int
    line: int
    last_line: int
    text: str
    original: str
    mutant: str

    @property
    def key(self) -> tuple[str, str, str, str]:
        """What names the change where line numbers do not: module, text of the line, expression before and after."""
        return self.module, self.text, self.original, self.mutant


def _replacements(node: ast.AST) -> Iterator[ast.AST]:
    """What may stand in the place of an expression."""
    match node:
        case ast.Compare():
            for i, operator in enumerate(node.ops):
                for other in COMPARISONS.get(type(operator), ()):
                    yield ast.Compare(node.left, [*node.ops[:i], other(), *node.ops[i + 1 :]], node.comparators)
        case ast.BinOp() if type(node.op) in OPERATORS:
            yield ast.BinOp(node.left, OPERATORS[type(node.op)](), node.right)
        case ast.Constant(value=bool() as value):
            yield ast.Constant(not value)
        case ast.Constant(value=int() | float() as value):
            yield from map(ast.Constant, (2 * value, -value) if value else (1, -1))
        case ast.UnaryOp(op=ast.Not() | ast.USub()):
            yield node.operand
        case ast.BoolOp():
            yield ast.BoolOp(ast.And() if isinstance(node.op, ast.Or) else ast.Or(), node.values)
        case ast.Name(id=name) if name in NAMES:
            yield ast.Name(NAMES[name])
        case ast.Attribute(attr=name) if name in NAMES:
            yield ast.Attribute(node.value, NAMES[name])
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name), args=[first, *_]) if name in TRANSPARENT:
            yield first
        case ast.Subscript(slice=ast.Constant(value=int() as value)):
            yield ast.Subscript(node.value, ast.Constant(value + 1))


def _deletion(node: ast.stmt) -> ast.stmt | None:
    """What stands in the place of a statement that is left out; None where its absence would only be a name that is missing."""
    match node:
        case ast.Return(value=ast.expr()) if not (isinstance(node.value, ast.Constant) and node.value.value is None):
            return ast.Return(ast.Constant(None))
        case ast.Raise() | ast.AugAssign() | ast.Expr(value=ast.Call() | ast.Yield()):
            return ast.Pass()
        case ast.Assign(targets=[ast.Attribute() | ast.Tuple() | ast.Subscript(), *_]) if not isinstance(
            node.targets[0], ast.Tuple
        ) or all(isinstance(target, ast.Attribute) for target in node.targets[0].elts):
            return ast.Pass()
    return None


def _places(tree: ast.Module) -> Iterator[tuple[ast.stmt, ast.AST, str, int | None, ast.AST]]:
    """Every change of a module: its statement, and what to set: parent, field, index, node."""

    def visit(parent: ast.AST, statement: ast.stmt | None) -> Iterator:
        for name, value in ast.iter_fields(parent):
            if name in ("annotation", "returns", "decorator_list"):
                continue
            for i, node in enumerate(value) if isinstance(value, list) else ((None, value),):
                if not isinstance(node, ast.AST) or isinstance(node, (ast.JoinedStr, ast.Import, ast.ImportFrom)):
                    continue
                if isinstance(node, ast.stmt):
                    if (deleted := _deletion(node)) is not None:
                        yield node, parent, name, i, deleted
                elif name == "test" and not isinstance(node, (ast.Compare, ast.UnaryOp)):
                    yield statement or parent, parent, name, i, ast.UnaryOp(ast.Not(), node)
                if isinstance(parent, ast.Subscript) and isinstance(node, ast.Constant):
                    continue  # an index, which the whole expression changes
                for other in _replacements(node):
                    yield statement, parent, name, i, other
                yield from visit(node, node if isinstance(node, ast.stmt) else statement)

    yield from visit(tree, None)


def mutants(module: str, source: str) -> list[Mutant]:
    """All mutants of a module, `module` its path within the sources."""
    lines, found = source.splitlines(), []
    for number, (statement, parent, field, i, other) in enumerate(_places(ast.parse(source))):
        old = getattr(parent, field) if i is None else getattr(parent, field)[i]
        if (
            isinstance(old, ast.Constant)
            and isinstance(parent, ast.UnaryOp)
            and isinstance(other, ast.Constant)
            and other.value == -old.value
        ):
            continue  # the sign is the parent's to change
        body = getattr(statement, "body", None)
        last = body[0].lineno - 1 if body and isinstance(body, list) else statement.end_lineno
        at = getattr(old, "lineno", statement.lineno)
        texts = [ast.unparse(ast.fix_missing_locations(node)) for node in (old, other)]
        found.append(Mutant(module, number, at, max(at, last), lines[at - 1].strip(), *texts))
    return found


def mutated(source: str, number: int) -> str:
    """The module with its mutant `number` in it."""
    tree = ast.parse(source)
    for n, (_, parent, field, i, other) in enumerate(_places(tree)):
        if n == number:
            setattr(parent, field, other) if i is None else getattr(parent, field).__setitem__(i, other)
            return ast.unparse(ast.fix_missing_locations(tree))
    raise IndexError(f"expected a mutant below {n + 1}, got {number}")
