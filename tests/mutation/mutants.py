"""Small faults that a seed draws from the sources: where a line can be wrong in one place, found in its syntax tree.

Neither docstrings, annotations, decorators, nor what is raised, logged or printed hold such places, nor how much of it
is told (``MOST_...``, ``LONGEST_...``).
"""

import ast
import difflib
import hashlib
import random
import re
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

AREAS = {
    "runner": ("pipeline",),
    "gp": ("stages/science/gp",),
    "discrepancy": ("stages/science/discrepancy", "stages/science/output_channels"),
    "recording": ("stages/science/recording",),
    "rig": ("stages/science/rig", "stages/science/operator_ui"),
}
OPERATORS = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
}
EXTREMES = {"min": "max", "minimum": "maximum", "argmin": "argmax", "nanmin": "nanmax", "floor": "ceil"}
EXTREMES |= {other: name for name, other in EXTREMES.items()}
UNSWAPPED = {*EXTREMES, "isinstance", "issubclass", "isclose", "allclose", "array_equal", "hypot", "gcd"}
"""Calls whose arguments change places to no effect, or never can."""
DROPPABLE = {"abs", "sorted", "round", "reversed", "sqrt", "log", "exp", "square", "cumsum"}
TELLING = {"debug", "info", "warning", "error", "critical", "print", "say", "_say", "complain", "tell", "add_note"}
TINY = 1e-4
"""Below which a number is a tolerance, which twice as large would be as good."""

Edit = tuple[str, int, int, bytes]
"""What kind of fault it is, and the bytes that are replaced, from where to where, and by which."""


@dataclass(frozen=True)
class Fault:
    """An edit of one place of one file; one that no seed drew has a title."""

    area: str
    file: str
    kind: str
    start: int
    end: int
    new: bytes
    within: str = ""
    title: str = ""

    def plant(self, source: bytes) -> bytes:
        """Return a source with the fault in it."""
        return source[: self.start] + self.new + source[self.end :]

    def name(self, source: bytes) -> str:
        """Return what it is called, whatever else changes in the file."""
        begun, ended = source.rfind(b"\n", 0, self.start) + 1, source.find(b"\n", self.end)
        told = [source[begun : self.start].lstrip(), source[self.start : self.end], self.new, source[self.end : ended]]
        named = b"\0".join([f"{self.file} {self.within}".encode(), *told])
        return self.title or hashlib.sha256(named).hexdigest()[:8]

    def place(self, source: bytes) -> str:
        """Return file and line."""
        line = source.count(b"\n", 0, self.start) + 1
        return f"{self.file}:{line}"

    def diff(self, source: bytes) -> str:
        """Return what changes, as a patch."""
        texts = [each.decode().splitlines(keepends=True) for each in (source, self.plant(source))]
        return "".join(difflib.unified_diff(*texts, f"a/{self.file}", f"b/{self.file}", n=2))


def draw(root: Path, seed: int, area: str) -> Iterator[Fault]:
    """Yield faults of an area: first a module is drawn, then a kind of fault, then the place; none comes twice."""
    generator = random.Random(f"{seed} {area}")
    modules = sorted(path for folder in AREAS[area] for path in (root / folder).rglob("*.py"))
    seen = set()
    while True:
        path = generator.choice(modules)
        faults, source = find_faults(root, path, area), path.read_bytes()
        if not faults:
            continue
        kind = generator.choice(sorted({each.kind for each in faults}))
        fault = generator.choice([each for each in faults if each.kind == kind])
        if fault.name(source) not in seen and is_valid(fault.plant(source)):
            seen.add(fault.name(source))
            yield fault


@cache
def find_faults(root: Path, path: Path, area: str) -> list[Fault]:
    """Return all faults that a module could have."""
    source, file = path.read_bytes(), path.relative_to(root).as_posix()
    finder = _Finder(source)
    return [Fault(area, file, *edit, within) for within, edit in finder.walk(ast.parse(source), "")]


def is_valid(source: bytes) -> bool:
    """Return whether a source can be compiled."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            compile(source, "planted", "exec")
    except SyntaxError:
        return False
    return True


class _Finder:
    def __init__(self, source: bytes):
        self.source = source
        self.lines = [0]
        for line in source.splitlines(keepends=True):
            self.lines.append(self.lines[-1] + len(line))

    def walk(self, node: ast.AST, within: str) -> Iterator[tuple[str, Edit]]:
        """Yield all edits of a node and of what lies in it, with the function or class around them."""
        for edit in self.edit(node):
            yield within, edit
        named = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
        for child in _list_children(node):
            yield from self.walk(child, f"{within}.{node.name}" if named else within)

    def edit(self, node: ast.AST) -> Iterator[Edit]:
        """Yield the edits of a node itself."""
        match node:
            case ast.BinOp(left, ast.Add() | ast.Sub(), right) if not (_is_text(left) or _is_text(right)):
                yield self.exchange("sign", node.op, left, right)
            case ast.AugAssign(left, ast.Add() | ast.Sub(), right) if not _is_text(right):
                yield self.exchange("sign", node.op, left, right)
            case ast.UnaryOp(ast.USub(), operand):
                yield "sign", *self.span(node), self.text(operand)
            case ast.Compare(left, operators, others):
                for one, operator, other in zip([left, *others], operators, others, strict=False):
                    if type(operator) in OPERATORS:
                        yield self.exchange("bound", operator, one, other)
            case ast.Expr(ast.Call(function)) if _last_name(function) not in TELLING:
                yield "call", *self.span(node.value), b"pass"
            case ast.Call(function, arguments, keywords) if _last_name(function) not in TELLING:
                yield from self.edit_call(node, _last_name(function), arguments, keywords)
            case ast.If(test) | ast.While(test) | ast.IfExp(test):
                yield from self.negate(test)
            case ast.comprehension(ifs=tests):
                for test in tests:
                    yield from self.negate(test)
            case ast.Constant(bool(value)):
                yield "constant", *self.span(node), str(not value).encode()
            case ast.Constant(int(value)):
                yield "constant", *self.span(node), str(value + 1 if value < 10 else 2 * value).encode()
            case ast.Constant(float(value)):
                yield "constant", *self.span(node), repr(value * (1000 if value < TINY else 2) or 1.0).encode()

    def edit_call(self, node: ast.Call, name: str, arguments: list[ast.expr], keywords: list) -> Iterator[Edit]:
        end = self.span(node.func)[1]
        if name in EXTREMES:
            yield "bound", end - len(name), end, EXTREMES[name].encode()
        if any(isinstance(each, ast.Starred) for each in arguments):
            return
        if name == "range":
            stop = arguments[min(len(arguments), 2) - 1]
            yield "bound", *self.span(stop), b"(" + self.text(stop) + b") - 1"
        if name in DROPPABLE and len(arguments) == 1 and not keywords:
            yield "call", *self.span(node), b"(" + self.text(arguments[0]) + b")"
        for one, other in pairwise(arguments) if name not in UNSWAPPED else ():
            (start, ended), (begun, end) = self.span(one), self.span(other)
            if self.text(one) != self.text(other):
                yield "arguments", start, end, self.text(other) + self.source[ended:begun] + self.text(one)

    def negate(self, test: ast.expr) -> Iterator[Edit]:
        names = {each.id for each in ast.walk(test) if isinstance(each, ast.Name)}
        negated = isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not)
        if not names & {"TYPE_CHECKING", "__name__"}:
            new = self.text(test.operand) if negated else b"not (" + self.text(test) + b")"
            yield "condition", *self.span(test), new

    def exchange(self, kind: str, operator: ast.AST, left: ast.expr, right: ast.expr) -> Edit:
        """Exchange the operator between two operands."""
        start, end = self.span(left)[1], self.span(right)[0]
        between = re.sub(rb"#[^\n]*", lambda comment: b" " * len(comment[0]), self.source[start:end])
        word, other = (each.encode() for each in OPERATORS[type(operator)])
        at = start + between.index(word)
        return kind, at, at + len(word), other

    def span(self, node: ast.expr) -> tuple[int, int]:
        return self.lines[node.lineno - 1] + node.col_offset, self.lines[node.end_lineno - 1] + node.end_col_offset

    def text(self, node: ast.expr) -> bytes:
        return self.source[slice(*self.span(node))]


def _list_children(node: ast.AST) -> Iterable[ast.AST]:
    """Return what lies in a node, but for annotations and what only tells."""
    match node:
        case ast.Raise() | ast.JoinedStr() | ast.keyword("strict") | ast.Subscript(ast.Name("Literal")):
            return ()
        case ast.Call(function) if _last_name(function) in TELLING:
            return ()
        case ast.Assign([ast.Name(name)]) if name.startswith(("MOST_", "LONGEST_")):
            return ()
        case ast.AnnAssign(value=value):
            return [value] if value else ()
        case ast.FunctionDef() | ast.AsyncFunctionDef():
            return [*node.args.defaults, *(each for each in node.args.kw_defaults if each), *node.body]
        case ast.ClassDef():
            return node.body
    return ast.iter_child_nodes(node)


def _last_name(node: ast.expr) -> str:
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))
