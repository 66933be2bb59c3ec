"""Faults that can be put into the kernels of a file, one small change of its text each.

Only functions under the decorator `kernel` are changed, and numeric constants of their module. Left
alone are decorators, docstrings, annotations and what stands inside `np.empty(...)`: room too large
is no fault, and room too small only writes past its end.
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
class Fault:
    """One change of one place in a file.

    Attributes
    ----------
    path
        File, relative to the root of the repository, with forward slashes.
    line, column
        Where the change starts; lines from 1, columns (bytes) from 0.
    operator
        Kind of change.
    start, end, text
        The bytes start to end of the file become `text`.
    code
        The line of code as it stands, stripped.
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
        """`file:line:column:operator`."""
        return f"{self.path}:{self.line}:{self.column}:{self.operator}"

    def applied(self, source: str) -> str:
        """Return the source with the fault in it."""
        raw = source.encode()
        return (raw[: self.start] + self.text.encode() + raw[self.end :]).decode()

    def line_after(self, source: str) -> str:
        """Return the line of code with the fault in it, stripped."""
        return self.applied(source).splitlines()[self.line - 1].strip()


class _Source:
    """The text of a file, its tokens and where its lines start, in bytes."""

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

    def _offset_of(self, place: tuple[int, int]) -> int:
        """Return the byte at a token's place, whose column counts characters."""
        line, column = place
        if line > len(self.lines):
            return len(self.raw)
        return self.starts[line - 1] + len(self.lines[line - 1][:column].encode())

    def start(self, node: ast.AST) -> int:
        return self.starts[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined]

    def end(self, node: ast.AST) -> int:
        return self.starts[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined]

    def segment(self, node: ast.AST) -> str:
        return self.raw[self.start(node) : self.end(node)].decode()

    def token(self, after: int, before: int, known: Container[str]) -> tuple[int, int, str] | None:
        """Return the first token of `known` that lies between two bytes."""
        first = bisect.bisect_left(self.tokens, (after,))
        for start, end, text in self.tokens[first:]:
            if end > before:
                break
            if text in known:
                return start, end, text
        return None

    def fault(self, start: int, end: int, text: str, operator: str) -> Fault:
        """Return the fault that sets `text` in the place of the bytes start to end."""
        line = bisect.bisect_right(self.starts, start) - 1
        return Fault(
            self.path, line + 1, start - self.starts[line], operator, start, end, text,
            self.lines[line].strip(),
        )  # fmt: skip


def _between(source: _Source, left: ast.expr, right: ast.expr, what: ast.AST) -> Iterator[Fault]:
    """Yield the faults of the operator between two operands."""
    start, end = source.end(left), source.start(right)
    if isinstance(what, ast.cmpop):
        for operator, table in (("opposite", _OPPOSITE), ("boundary", _BOUNDARY)):
            if found := source.token(start, end, table):
                yield source.fault(found[0], found[1], table[found[2]], operator)
    elif isinstance(what, ast.boolop):
        if found := source.token(start, end, ("and", "or")):
            other = "or" if found[2] == "and" else "and"
            yield source.fault(found[0], found[1], other, "and-or")
    elif found := source.token(start, end, _ARITHMETIC):
        operator, other = _ARITHMETIC[found[2]]
        yield source.fault(found[0], found[1], other, operator)


def _dropped(source: _Source, node: ast.BinOp) -> Iterator[Fault]:
    """Yield the fault that drops the second operand of a sum, a difference or a product."""
    found = source.token(source.end(node.left), source.start(node.right), ("+", "-", "*"))
    if found and isinstance(node.op, ast.Add | ast.Sub | ast.Mult):
        yield source.fault(found[0], source.end(node), "", "drop-term")


def _constant(source: _Source, node: ast.Constant, subscript: bool) -> Iterator[Fault]:
    """Yield the fault that changes a number: by half, by one, or by one place in an index."""
    value = node.value
    if isinstance(value, bool):
        yield source.fault(source.start(node), source.end(node), str(not value), "constant")
    elif isinstance(value, int):
        operator = "index" if subscript else "constant"
        yield source.fault(source.start(node), source.end(node), str(value + 1), operator)
    elif isinstance(value, float):
        text = repr(1.5 * value if value else 1.0)
        yield source.fault(source.start(node), source.end(node), text, "constant")


def _call(source: _Source, node: ast.Call) -> Iterator[Fault]:
    """Yield the faults of a call: another function, arguments swapped, a range one short."""
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


def _statement(source: _Source, node: ast.stmt) -> Iterator[Fault]:
    """Yield the faults of a statement: left out, its sign turned, its condition negated."""
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


def _of_node(source: _Source, node: ast.AST, subscript: bool) -> Iterator[Fault]:
    """Yield the faults of one node of the tree, without those of its children."""
    if isinstance(node, ast.Compare):
        operands = [node.left, *node.comparators]
        for left, right, what in zip(operands, operands[1:], node.ops, strict=False):
            yield from _between(source, left, right, what)
    elif isinstance(node, ast.BoolOp):
        for left, right in zip(node.values, node.values[1:], strict=False):
            yield from _between(source, left, right, node.op)
    elif isinstance(node, ast.BinOp):
        yield from _between(source, node.left, node.right, node.op)
        yield from _dropped(source, node)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        if not isinstance(node.operand, ast.Constant):
            text = f"({source.segment(node.operand)})"
            yield source.fault(source.start(node), source.end(node), text, "sign")
    elif isinstance(node, ast.Constant):
        yield from _constant(source, node, subscript)
    elif isinstance(node, ast.Call):
        yield from _call(source, node)
    elif isinstance(node, ast.stmt):
        yield from _statement(source, node)


def _within(source: _Source, node: ast.AST, subscript: bool = False) -> Iterator[Fault]:
    """Yield the faults of a node and of what stands in it."""
    if isinstance(node, ast.Call) and ast.unparse(node.func) in ("np.empty", "numpy.empty"):
        return
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return  # a docstring
    yield from _of_node(source, node, subscript)
    for field, value in ast.iter_fields(node):
        inside = subscript or (isinstance(node, ast.Subscript) and field == "slice")
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and field not in ("annotation", "returns"):
                yield from _within(source, child, inside)


def _is_kernel(node: ast.AST) -> bool:
    return isinstance(node, ast.FunctionDef) and any(
        isinstance(d, ast.Call) and isinstance(d.func, ast.Name) and d.func.id == "kernel"
        for d in node.decorator_list
    )


def kernel_lines(text: str) -> int:
    """Return the number of lines of the kernels in a file."""
    tree = ast.parse(text)
    return sum(n.end_lineno - n.lineno + 1 for n in tree.body if _is_kernel(n))  # type: ignore[attr-defined]


def faults_of(path: str, text: str) -> list[Fault]:
    """Return all faults that can be put into the kernels of a file, in order of their names.

    Parameters
    ----------
    path
        What the faults' names are to say of the file.
    text
        What stands in it.
    """
    source = _Source(path, text)
    found: list[Fault] = []
    for node in ast.parse(text).body:
        if _is_kernel(node):
            for statement in node.body:  # type: ignore[attr-defined]
                found += _within(source, statement)
        elif isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(
            node.value, ast.Constant | ast.BinOp | ast.UnaryOp
        ):
            found += _within(source, node.value)
    return sorted(set(found), key=lambda f: (f.line, f.column, f.operator, f.text))


def drawn(faults: list[Fault], count: int, seed: int) -> list[Fault]:
    """Return `count` of the faults of a file, of every operator in turn.

    The order within an operator goes by a hash of seed, code and place in the line, so that a
    change elsewhere in the file does not draw other faults.
    """

    def rank(fault: Fault) -> str:
        key = f"{seed}:{fault.path}:{fault.code}:{fault.column}:{fault.operator}:{fault.text}"
        return hashlib.sha256(key.encode()).hexdigest()

    queues: dict[str, list[Fault]] = {}
    for fault in sorted(faults, key=rank):
        queues.setdefault(fault.operator, []).append(fault)
    order: list[Fault] = []
    depth = 0
    while len(order) < min(count, len(faults)):
        order += [queue[depth] for queue in queues.values() if depth < len(queue)]
        depth += 1
    return order[:count]
