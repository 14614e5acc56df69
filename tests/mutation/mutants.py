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
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

AREAS = {
    "runner": "pipeline",
    "gp": "stages/gp",
    "discrepancy": "stages/discrepancy",
    "recording": "stages/recording",
    "rig": "stages/rig",
}
SIGNS = {ast.Add: ("+", "-"), ast.Sub: ("-", "+")}
BOUNDS = {ast.Lt: ("<", "<="), ast.LtE: ("<=", "<"), ast.Gt: (">", ">="), ast.GtE: (">=", ">")}
EXTREMES = {"min": "max", "minimum": "maximum", "argmin": "argmax", "nanmin": "nanmax", "floor": "ceil"}
EXTREMES |= {other: name for name, other in EXTREMES.items()}
SYMMETRIC = {*EXTREMES, "isclose", "allclose", "array_equal", "hypot", "gcd"}
DROPPABLE = {"abs", "sorted", "round", "reversed", "sqrt", "log", "exp", "square", "cumsum"}
TELLING = {"debug", "info", "warning", "error", "critical", "print", "say", "_say", "_complain", "tell", "add_note"}
TINY = 1e-4
"""Below which a number is a tolerance, which twice as large would be as good."""


@dataclass(frozen=True)
class Fault:
    """One place of one file, and what stands there instead.

    Parameters
    ----------
    area, kind : str
        A key of `AREAS`, and what is wrong.
    file : str
        From the project's folder.
    start, end : int
        Bytes of the file that are replaced.
    new : bytes
        By which.
    within : str
        Function or class that it lies in, if any.
    title : str
        By which it is called, where a seed did not draw it.
    """

    area: str
    kind: str
    file: str
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
        if self.title:
            return self.title
        begun, ended = source.rfind(b"\n", 0, self.start) + 1, source.find(b"\n", self.end)
        told = [source[begun : self.start].lstrip(), source[self.start : self.end], self.new, source[self.end : ended]]
        return hashlib.sha256(b"\0".join([f"{self.file} {self.within}".encode(), *told])).hexdigest()[:8]

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
    modules = sorted((root / AREAS[area]).rglob("*.py"))
    seen = set()
    while True:
        path = generator.choice(modules)
        faults = find_faults(root, path, area)
        if not faults:
            continue
        kind = generator.choice(sorted({each.kind for each in faults}))
        fault = generator.choice([each for each in faults if each.kind == kind])
        name = fault.name(path.read_bytes())
        if name not in seen and is_valid(fault.plant(path.read_bytes())):
            seen.add(name)
            yield fault


@cache
def find_faults(root: Path, path: Path, area: str) -> tuple[Fault, ...]:
    """Return all faults that a module could have."""
    finder = _Finder(path.read_bytes())
    finder.visit(ast.parse(finder.source))
    file = path.relative_to(root).as_posix()
    return tuple(replace(each, area=area, file=file) for each in finder.found)


def is_valid(source: bytes) -> bool:
    """Return whether a source can be compiled."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            compile(source, "planted", "exec")
    except SyntaxError:
        return False
    return True


class _Finder(ast.NodeVisitor):
    def __init__(self, source: bytes):
        self.source = source
        self.found: list[Fault] = []
        self._within: list[str] = []
        self._lines = [0]
        for line in source.splitlines(keepends=True):
            self._lines.append(self._lines[-1] + len(line))

    def _add(self, kind: str, start: int, end: int, new: bytes) -> None:
        self.found.append(Fault("", kind, "", start, end, new, ".".join(self._within)))

    def _span(self, node: ast.expr) -> tuple[int, int]:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self._lines[node.lineno - 1] + node.col_offset, self._lines[node.end_lineno - 1] + node.end_col_offset

    def _text(self, node: ast.expr) -> bytes:
        return self.source[slice(*self._span(node))]

    def _exchange(self, kind: str, start: int, end: int, words: tuple[str, str]) -> None:
        """Exchange an operator between two operands."""
        between = re.sub(rb"#[^\n]*", lambda comment: b" " * len(comment[0]), self.source[start:end])
        at = start + between.index(words[0].encode())
        self._add(kind, at, at + len(words[0]), words[1].encode())

    def _negate(self, test: ast.expr) -> None:
        if {"TYPE_CHECKING", "__name__"} & {each.id for each in ast.walk(test) if isinstance(each, ast.Name)}:
            return
        negated = isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not)
        new = self._text(test.operand) if negated else b"not (" + self._text(test) + b")"
        self._add("condition", *self._span(test), new)

    def _enter(self, node: ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef, parts: list[ast.AST]) -> None:
        self._within.append(node.name)
        for each in [*parts, *node.body]:
            self.visit(each)
        self._within.pop()

    def visit_FunctionDef(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> None:
        self._enter(node, [*node.args.defaults, *(each for each in node.args.kw_defaults if each)])

    def visit_AsyncFunctionDef(self, node: ast.AsyncFunctionDef) -> None:
        self.visit_FunctionDef(node)

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        self._enter(node, [])

    def visit_Assign(self, node: ast.Assign) -> None:
        if not _last_name(node.targets[0]).startswith(("MOST_", "LONGEST_")):
            self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value:
            self.visit(node.value)

    def visit_Raise(self, node: ast.Raise) -> None:
        """Pass over what is told."""

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """Pass over what is told."""

    def visit_Subscript(self, node: ast.Subscript) -> None:
        if _last_name(node.value) != "Literal":
            self.generic_visit(node)

    def visit_keyword(self, node: ast.keyword) -> None:
        if node.arg != "strict":
            self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        words = SIGNS.get(type(node.op))
        if words and not any(_is_text(each) for each in (node.left, node.right)):
            self._exchange("sign", self._span(node.left)[1], self._span(node.right)[0], words)
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        words = SIGNS.get(type(node.op))
        if words and not _is_text(node.value):
            self._exchange("sign", self._span(node.target)[1], self._span(node.value)[0], words)
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, ast.USub):
            self._add("sign", *self._span(node), self._text(node.operand))
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        operands = [node.left, *node.comparators]
        for left, operator, right in zip(operands, node.ops, operands[1:], strict=False):
            if type(operator) in BOUNDS:
                self._exchange("bound", self._span(left)[1], self._span(right)[0], BOUNDS[type(operator)])
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        name = _last_name(node.func)
        if name in TELLING:
            return
        end = self._span(node.func)[1]
        if name in EXTREMES:
            self._add("bound", end - len(name), end, EXTREMES[name].encode())
        if name == "range" and not isinstance(node.args[0], ast.Starred):
            stop = node.args[min(len(node.args), 2) - 1]
            self._add("bound", *self._span(stop), b"(" + self._text(stop) + b") - 1")
        if name in DROPPABLE and len(node.args) == 1 and not node.keywords:
            self._add("call", *self._span(node), b"(" + self._text(node.args[0]) + b")")
        if name not in SYMMETRIC and not any(isinstance(each, ast.Starred) for each in node.args):
            for one, other in zip(node.args, node.args[1:], strict=False):
                (start, middle), (after, stop) = self._span(one), self._span(other)
                new = self._text(other) + self.source[middle:after] + self._text(one)
                if self._text(one) != self._text(other):
                    self._add("arguments", start, stop, new)
        self.generic_visit(node)

    def visit_Expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Call) and _last_name(node.value.func) not in TELLING:
            self._add("call", *self._span(node.value), b"pass")
        self.generic_visit(node)

    def visit_If(self, node: ast.If | ast.While | ast.IfExp) -> None:
        self._negate(node.test)
        self.generic_visit(node)

    def visit_While(self, node: ast.While) -> None:
        self.visit_If(node)

    def visit_IfExp(self, node: ast.IfExp) -> None:
        self.visit_If(node)

    def visit_comprehension(self, node: ast.comprehension) -> None:
        for each in node.ifs:
            self._negate(each)
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        value = node.value
        if isinstance(value, bool):
            self._add("constant", *self._span(node), str(not value).encode())
        elif isinstance(value, int):
            self._add("constant", *self._span(node), str(value + 1 if value < 10 else 2 * value).encode())
        elif isinstance(value, float):
            changed = value * (1000 if value < TINY else 2) or 1.0
            self._add("constant", *self._span(node), repr(changed).encode())


def _last_name(node: ast.expr) -> str:
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))
