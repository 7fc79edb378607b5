"""Mutants of a source file: copies with one small defect each, as a programmer's slip would make it."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass
from pathlib import Path

_SWAPPED: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.And: ast.Or,
    ast.Or: ast.And,
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
}
_LEFT_ALONE = (ast.Raise, ast.Assert, ast.AnnAssign, ast.Import, ast.ImportFrom)
_DECLARED = ("frozen", "slots")  # for the type checker, which finds what breaks them
_TYPES = ("annotation", "returns", "decorator_list", "bases", "type_params")
_LOGGERS = ("_log.", "self._log.")


@dataclass(frozen=True, slots=True)
class Mutant:
    """One defect: the bytes of the file from `start` to `end` become `text`; `function` is "" outside functions."""

    file: Path
    function: str
    line: int
    start: int
    end: int
    was: str
    text: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.was} -> {self.text}"

    def applied(self) -> bytes:
        """The content of the file with the defect."""
        source = self.file.read_bytes()
        return source[: self.start] + self.text.encode() + source[self.end :]


def mutants_of(file: Path) -> Iterator[Mutant]:
    """Every mutant of a Python file, in the order of its lines."""
    source = file.read_bytes()
    offsets = [0]
    for line in source.splitlines(keepends=True):
        offsets.append(offsets[-1] + len(line))
    for node, function in _nodes(ast.parse(source)):
        changed = _changed(node)
        if changed is not None:
            start = offsets[node.lineno - 1] + node.col_offset
            end = offsets[(node.end_lineno or node.lineno) - 1] + (node.end_col_offset or 0)
            yield Mutant(file, function, node.lineno, start, end, ast.unparse(node), changed)


def _nodes(node: ast.AST, function: str = "", prefix: str = "") -> Iterator[tuple[ast.expr | ast.stmt, str]]:
    """The expressions and statements that say what is done, not of which type a value is, each with its function."""
    if isinstance(node, _LEFT_ALONE) or (isinstance(node, ast.keyword) and node.arg in _DECLARED):
        return
    if isinstance(node, ast.expr | ast.stmt):
        yield node, function
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        function = prefix + node.name
        prefix = f"{function}.<locals>."
    elif isinstance(node, ast.ClassDef):
        prefix = f"{prefix}{node.name}."
    for name, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and name not in _TYPES:
                yield from _nodes(child, function, prefix)


def _changed(node: ast.expr | ast.stmt) -> str | None:
    """The source of the node with its defect; None for a node that gets none."""
    mutant = copy(node)
    match mutant:
        case ast.Compare(ops=[operator]):
            mutant.ops = [_SWAPPED[type(operator)]()]  # type: ignore[list-item]
        case ast.BoolOp(op=operator):
            mutant.op = _SWAPPED[type(operator)]()  # type: ignore[assignment]
        case ast.BinOp(op=operator) if type(operator) in _SWAPPED and not _is_text(node):
            mutant.op = _SWAPPED[type(operator)]()  # type: ignore[assignment]
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return f"({ast.unparse(operand)})"
        case ast.Constant(value=bool() as value):
            return str(not value)
        case ast.Constant(value=int() | float() as value):
            return str(value + 1)
        case ast.Expr(value=ast.Call() | ast.Await()) if not ast.unparse(node).startswith(_LOGGERS):
            return "pass"
        case _:
            return None
    return f"({ast.unparse(mutant)})"


def _is_text(node: ast.AST) -> bool:
    """Whether texts are joined there: with another operator nothing runs."""
    return any(isinstance(part, ast.JoinedStr | ast.List) or _is_str(part) for part in ast.walk(node))


def _is_str(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)
