"""Generate the faults (mutants) of a kernel file: one small change each.

Only functions with the decorator `kernel` and numeric constants of their module are changed.
Decorators, docstrings, annotations and the arguments of `np.empty(...)` stay unchanged: a larger
array is no fault, and a smaller one only causes writes past its end.
"""

from __future__ import annotations

import ast
import bisect
import hashlib
import io
import tokenize
from collections.abc import Container, Iterator
from dataclasses import dataclass

_OPPOSITE = {"<": ">=", "<=": ">", ">": "<=", ">=": "<", "==": "!=", "!=": "=="}
_BOUNDARY = {"<": "<=", "<=": "<", ">": ">=", ">=": ">"}
_ARITHMETIC = {
    "+": ("plus-minus", "-"),
    "-": ("plus-minus", "+"),
    "*": ("times-over", "/"),
    "/": ("times-over", "*"),
    ">>": ("shift", "<<"),
    "<<": ("shift", ">>"),
}
_CALLS = {
    "min": ("min-max", "max"),
    "max": ("min-max", "min"),
    "minimum": ("min-max", "maximum"),
    "maximum": ("min-max", "minimum"),
    "smaller": ("min-max", "larger"),
    "larger": ("min-max", "smaller"),
    "sin": ("function", "cos"),
    "cos": ("function", "sin"),
    "floor": ("function", "ceil"),
    "ceil": ("function", "floor"),
}
_SYMMETRIC = {"min", "max", "hypot", "minimum", "maximum", "smaller", "larger", "range", "prange"}


@dataclass(frozen=True)
class Mutant:
    """A fault for mutation tests: one small change at one place in a source file.

    Attributes
    ----------
    path
        File, relative to the root of the repository, with forward slashes.
    line, column
        Start of the change; lines from 1, columns (bytes) from 0.
    operator
        Kind of change.
    start, end, text
        The bytes start to end of the file are replaced by `text`.
    code
        Line of code without the fault, stripped.
    """

    path: str
    line: int
    column: int
    operator: str
    start: int
    end: int
    text: str
    code: str

    @property
    def name(self) -> str:
        """Name of the fault, `file:line:column:operator`."""
        return f"{self.path}:{self.line}:{self.column}:{self.operator}"

    def apply(self, source: str) -> str:
        """Return the source text of the file with the fault in it."""
        raw = source.encode()
        return (raw[: self.start] + self.text.encode() + raw[self.end :]).decode()

    def line_after(self, source: str) -> str:
        """Return the changed line of code of `source` with the fault, stripped."""
        return self.apply(source).splitlines()[self.line - 1].strip()


class _SourceText:
    """Text of a file with its tokens and the byte offsets of its lines."""

    def __init__(self, path: str, text: str) -> None:
        self.path = path
        self.lines = text.splitlines(keepends=True)
        self.starts = [0]
        for line in self.lines:
            self.starts.append(self.starts[-1] + len(line.encode()))
        self.raw = text.encode()
        self.tokens = [
            (self._offset_of(t.start), self._offset_of(t.end), t.string)
            for t in tokenize.generate_tokens(io.StringIO(text).readline)
            if t.type in (tokenize.OP, tokenize.NAME)
        ]

    def _offset_of(self, position: tuple[int, int]) -> int:
        """Return the byte offset of a token position (line, column in characters)."""
        line, column = position
        if line > len(self.lines):
            return len(self.raw)
        return self.starts[line - 1] + len(self.lines[line - 1][:column].encode())

    def start(self, node: ast.AST) -> int:
        """Return the byte offset of the start of a syntax node."""
        return self.starts[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined]

    def end(self, node: ast.AST) -> int:
        """Return the byte offset of the end of a syntax node."""
        return self.starts[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined]

    def segment(self, node: ast.AST) -> str:
        """Return the source text of a syntax node."""
        return self.raw[self.start(node) : self.end(node)].decode()

    def token(self, after: int, before: int, known: Container[str]) -> tuple[int, int, str] | None:
        """Return start, end and text of the first token of `known` between two offsets.

        Offsets are in bytes; None if there is no such token.
        """
        first = bisect.bisect_left(self.tokens, (after,))
        for start, end, text in self.tokens[first:]:
            if end > before:
                break
            if text in known:
                return start, end, text
        return None

    def fault(self, start: int, end: int, text: str, operator: str) -> Mutant:
        """Return the fault that replaces the bytes start to end by `text`."""
        line = bisect.bisect_right(self.starts, start) - 1
        return Mutant(
            self.path, line + 1, start - self.starts[line], operator, start, end, text,
            self.lines[line].strip(),
        )  # fmt: skip


def _operator_faults(
    source: _SourceText, left: ast.expr, right: ast.expr, operator_node: ast.AST
) -> Iterator[Mutant]:
    """Yield the faults that replace the operator between two operands by another."""
    start, end = source.end(left), source.start(right)
    if isinstance(operator_node, ast.cmpop):
        for operator, table in (("opposite", _OPPOSITE), ("boundary", _BOUNDARY)):
            if found := source.token(start, end, table):
                yield source.fault(found[0], found[1], table[found[2]], operator)
    elif isinstance(operator_node, ast.boolop):
        if found := source.token(start, end, ("and", "or")):
            other = "or" if found[2] == "and" else "and"
            yield source.fault(found[0], found[1], other, "and-or")
    elif found := source.token(start, end, _ARITHMETIC):
        operator, other = _ARITHMETIC[found[2]]
        yield source.fault(found[0], found[1], other, operator)


def _term_fault(source: _SourceText, node: ast.BinOp) -> Iterator[Mutant]:
    """Yield the fault that drops the second operand of a sum, difference or product."""
    found = source.token(source.end(node.left), source.start(node.right), ("+", "-", "*"))
    if found and isinstance(node.op, ast.Add | ast.Sub | ast.Mult):
        yield source.fault(found[0], source.end(node), "", "drop-term")


def _constant_fault(source: _SourceText, node: ast.Constant, subscript: bool) -> Iterator[Mutant]:
    """Yield the fault that changes a constant: times 1.5, plus one, or negated.

    `subscript`: whether the number is an array index.
    """
    value = node.value
    if isinstance(value, bool):
        yield source.fault(source.start(node), source.end(node), str(not value), "constant")
    elif isinstance(value, int):
        operator = "index" if subscript else "constant"
        yield source.fault(source.start(node), source.end(node), str(value + 1), operator)
    elif isinstance(value, float):
        text = repr(1.5 * value if value else 1.0)
        yield source.fault(source.start(node), source.end(node), text, "constant")


def _call_faults(source: _SourceText, node: ast.Call) -> Iterator[Mutant]:
    """Yield the faults of a call: other function, swapped arguments, shorter range."""
    func = node.func
    name = func.attr if isinstance(func, ast.Attribute) else getattr(func, "id", "")
    if name in _CALLS:
        operator, other = _CALLS[name]
        end = source.end(func)
        yield source.fault(end - len(name), end, other, operator)
    if name == "abs" and len(node.args) == 1:
        text = f"({source.segment(node.args[0])})"
        yield source.fault(source.start(node), source.end(node), text, "sign")
    if name in ("range", "prange") and node.args:
        stop = node.args[0 if len(node.args) == 1 else 1]
        text = f"({source.segment(stop)}) - 1"
        yield source.fault(source.start(stop), source.end(stop), text, "range")
    if name not in _SYMMETRIC:
        for a, b in zip(node.args, node.args[1:], strict=False):
            if isinstance(a, ast.Name) and isinstance(b, ast.Name) and a.id != b.id:
                text = f"{b.id}, {a.id}"
                yield source.fault(source.start(a), source.end(b), text, "swap-arguments")


def _statement_faults(source: _SourceText, node: ast.stmt) -> Iterator[Mutant]:
    """Yield the faults of a statement: dropped, sign changed, or condition negated."""
    span = source.start(node), source.end(node)
    if isinstance(node, ast.AugAssign):
        yield source.fault(*span, "pass", "drop-statement")
        if found := source.token(source.end(node.target), source.start(node.value), ("+=", "-=")):
            other = "-=" if found[2] == "+=" else "+="
            yield source.fault(found[0], found[1], other, "plus-minus")
    elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Subscript):
        yield source.fault(*span, "pass", "drop-statement")
    elif isinstance(node, ast.Continue):
        yield source.fault(*span, "break", "drop-statement")
    elif isinstance(node, ast.Break):
        yield source.fault(*span, "pass", "drop-statement")
    elif isinstance(node, ast.If) and not isinstance(node.test, ast.Compare):
        text = f"not ({source.segment(node.test)})"
        yield source.fault(source.start(node.test), source.end(node.test), text, "opposite")


def _node_faults(source: _SourceText, node: ast.AST, subscript: bool) -> Iterator[Mutant]:
    """Yield the faults of one syntax node, without the faults of its children.

    `subscript`: whether the node is within an array index.
    """
    if isinstance(node, ast.Compare):
        operands = [node.left, *node.comparators]
        for left, right, comparison in zip(operands, operands[1:], node.ops, strict=False):
            yield from _operator_faults(source, left, right, comparison)
    elif isinstance(node, ast.BoolOp):
        for left, right in zip(node.values, node.values[1:], strict=False):
            yield from _operator_faults(source, left, right, node.op)
    elif isinstance(node, ast.BinOp):
        yield from _operator_faults(source, node.left, node.right, node.op)
        yield from _term_fault(source, node)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        if not isinstance(node.operand, ast.Constant):
            text = f"({source.segment(node.operand)})"
            yield source.fault(source.start(node), source.end(node), text, "sign")
    elif isinstance(node, ast.Constant):
        yield from _constant_fault(source, node, subscript)
    elif isinstance(node, ast.Call):
        yield from _call_faults(source, node)
    elif isinstance(node, ast.stmt):
        yield from _statement_faults(source, node)


def _faults_within(source: _SourceText, node: ast.AST, subscript: bool = False) -> Iterator[Mutant]:
    """Yield the faults of a syntax node and of all its children."""
    if isinstance(node, ast.Call) and ast.unparse(node.func) in ("np.empty", "numpy.empty"):
        return
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return  # a docstring
    yield from _node_faults(source, node, subscript)
    for field, value in ast.iter_fields(node):
        inside = subscript or (isinstance(node, ast.Subscript) and field == "slice")
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and field not in ("annotation", "returns"):
                yield from _faults_within(source, child, inside)


def _is_kernel(node: ast.AST) -> bool:
    """Return whether a syntax node is a function with the decorator `kernel`."""
    return isinstance(node, ast.FunctionDef) and any(
        isinstance(d, ast.Call) and isinstance(d.func, ast.Name) and d.func.id == "kernel"
        for d in node.decorator_list
    )


def kernel_lines(text: str) -> int:
    """Return the number of lines of all kernels in the source text of a file."""
    tree = ast.parse(text)
    return sum(n.end_lineno - n.lineno + 1 for n in tree.body if _is_kernel(n))  # type: ignore[attr-defined]


def faults_of(path: str, text: str) -> list[Mutant]:
    """Return all faults of the kernels in a file, in order of their positions.

    Parameters
    ----------
    path
        Path for the names of the faults.
    text
        Content of the file.
    """
    source = _SourceText(path, text)
    found: list[Mutant] = []
    for node in ast.parse(text).body:
        if _is_kernel(node):
            for statement in node.body:  # type: ignore[attr-defined]
                found += _faults_within(source, statement)
        elif isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(
            node.value, ast.Constant | ast.BinOp | ast.UnaryOp
        ):
            found += _faults_within(source, node.value)
    return sorted(set(found), key=lambda f: (f.line, f.column, f.operator, f.text))


def sample_faults(faults: list[Mutant], count: int, seed: int) -> list[Mutant]:
    """Select `count` faults of a file at random, cycling through the operators.

    The order within an operator is a hash of seed, code and place in the line, so that a change
    elsewhere in the file does not change the selection.
    """

    def rank(fault: Mutant) -> str:
        key = f"{seed}:{fault.path}:{fault.code}:{fault.column}:{fault.operator}:{fault.text}"
        return hashlib.sha256(key.encode()).hexdigest()

    queues: dict[str, list[Mutant]] = {}
    for fault in sorted(faults, key=rank):
        queues.setdefault(fault.operator, []).append(fault)
    order: list[Mutant] = []
    depth = 0
    while len(order) < min(count, len(faults)):
        order += [queue[depth] for queue in queues.values() if depth < len(queue)]
        depth += 1
    return order[:count]
