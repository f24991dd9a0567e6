"""What can be changed in a module: every place where one small change of the source may change what it does.

Strings are never changed, nor what stands in them: they are what people read. What else is left out, and why, is counted.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from tests.mutation.showing import Head, Holder, shown_as

EDGES: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Pow: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitOr,
    ast.MatMult: ast.Mult,
}
SWAPPED = dict(
    pair
    for a, b in [
        ("min", "max"),
        ("any", "all"),
        ("minimum", "maximum"),
        ("fmin", "fmax"),
        ("argmin", "argmax"),
        ("floor", "ceil"),
        ("sin", "cos"),
    ]
    for pair in ((a, b), (b, a))
)
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)

Undo = Callable[[], None]


@dataclass(frozen=True)
class Place:
    """One change. scope: the qualified name of the function or class it stands in; lines: of its statement's own text.

    left_out: why it is not tried; empty: it is.
    """

    scope: str
    lines: range
    text: str
    number: int
    left_out: str = ""


def places(tree: ast.Module) -> Iterator[Place]:
    """Every change of the tree; the tree is as before after each."""
    yield from _Places(tree).all()


def change(tree: ast.Module, number: int) -> None:
    """Make the change of the place with this number, for good."""
    next(apply for i, (_, _, apply) in enumerate(_Places(tree).raw()) if i == number)()


class _Places:
    def __init__(self, tree: ast.Module) -> None:
        self.tree = tree
        self.up: dict[ast.AST, ast.AST] = {
            child: parent for parent in ast.walk(tree) for child in ast.iter_child_nodes(parent)
        }

    def raw(self) -> Iterator[tuple[ast.AST, ast.AST, Callable[[], Undo]]]:
        """(where, what to show, the change), of everything that can be changed."""
        for node in list(ast.walk(self.tree)):
            for shown, apply in self._changes(node):
                yield node, shown, apply

    def all(self) -> Iterator[Place]:
        for number, (node, shown, apply) in enumerate(self.raw()):
            before = shown_as(shown)
            undo = apply()
            after = shown_as(shown)
            undo()
            if before != after:
                text = f"left out: {before}" if after == "pass" else f"{before}  ->  {after}"
                yield Place(self._scope(node), self._lines(node), text, number, self._left_out(node))

    # ------------------------------------------------------------ where

    def _above(self, node: ast.AST) -> Iterator[ast.AST]:
        """The node and all that it stands in."""
        while node is not self.tree:
            yield node
            node = self.up[node]

    def _scope(self, node: ast.AST) -> str:
        names = [n.name for n in self._above(node) if isinstance(n, (*FUNCTIONS, ast.ClassDef))]
        return ".".join(reversed(names)) or "<module>"

    def _lines(self, node: ast.AST) -> range:
        if isinstance(node, ast.match_case):
            return range(node.pattern.lineno, node.pattern.lineno + 1)
        inner = node
        for above in self._above(node):
            if isinstance(above, ast.match_case):
                return range(
                    above.pattern.lineno, max(above.pattern.end_lineno or 0, getattr(inner, "end_lineno", 0)) + 1
                )
            if isinstance(above, ast.stmt):
                body = getattr(above, "body", None) or getattr(above, "cases", None)
                if not body:
                    return range(above.lineno, (above.end_lineno or above.lineno) + 1)
                first = body[0].pattern.lineno if isinstance(body[0], ast.match_case) else body[0].lineno
                return range(above.lineno, max(first, above.lineno + 1))
            inner = above
        raise ValueError("no statement")

    def _left_out(self, node: ast.AST) -> str:
        for inner in self._above(node):
            outer = self.up[inner]
            match outer:
                case ast.AnnAssign() if inner is outer.annotation:
                    return "a type"
                case ast.arg():
                    return "a type"
                case ast.FunctionDef() if inner is outer.returns:
                    return "a type"
                case ast.FunctionDef() | ast.ClassDef() if inner in outer.decorator_list:
                    return "of a decorator: frozen, slots, size of a cache"
                case ast.JoinedStr():
                    return "within a sentence"
                case ast.Call(func=ast.Name(id="zip")) if isinstance(inner, ast.keyword):
                    return "states what the types cannot"
                case ast.Raise():
                    return "what an error says"
                case ast.Assert():
                    return "states what the types cannot"
        return ""

    # ------------------------------------------------------------ what

    def _changes(self, node: ast.AST) -> Iterator[tuple[ast.AST, Callable[[], Undo]]]:
        """(what of the tree to show, the change)."""
        match node:
            case ast.Compare():
                for i, op in enumerate(node.ops):
                    for other in EDGES.get(type(op), ()):
                        yield node, _set(node, "ops", [*node.ops[:i], other(), *node.ops[i + 1 :]])
            case ast.BinOp() | ast.AugAssign() if type(node.op) in ARITHMETIC and not _is_text(node):
                yield node, _set(node, "op", ARITHMETIC[type(node.op)]())
            case ast.BoolOp():
                yield node, _set(node, "op", ast.Or() if isinstance(node.op, ast.And) else ast.And())
                for i in range(len(node.values)):
                    rest = node.values[:i] + node.values[i + 1 :]
                    yield node, _set(node, "values", rest if len(rest) > 1 else rest * 2)
            case ast.UnaryOp(op=ast.Not() | ast.USub() | ast.Invert()):
                yield self._parent_of(node), self._put(node, node.operand)
            case ast.Constant():
                yield from self._constants(node)
            case ast.Call():
                yield from self._calls(node)
            case ast.If() | ast.IfExp() | ast.While():
                for value in (True, False):
                    if not isinstance(node.test, ast.Constant):
                        yield Head(node), _set(node, "test", _constant(value, node.test))
            case ast.comprehension():
                for i in range(len(node.ifs)):
                    yield self.up[node], _set(node, "ifs", node.ifs[:i] + node.ifs[i + 1 :])
            case ast.match_case():
                if node.guard is not None:
                    for value in (True, False):
                        yield Head(node), _set(node, "guard", _constant(value, node.guard))
                elif not _takes_all(node.pattern):
                    yield Head(node), _set(node, "guard", _constant(False, node.pattern))
            case ast.MatchOr():
                for i in range(len(node.patterns)):
                    rest = node.patterns[:i] + node.patterns[i + 1 :]
                    yield node, _set(node, "patterns", rest if len(rest) > 1 else rest * 2)
            case ast.Slice():
                for bound in ("lower", "upper"):
                    if getattr(node, bound) is not None:
                        yield self.up[node], _set(node, bound, None)
            case ast.stmt():
                yield from self._statements(node)

    def _constants(self, node: ast.Constant) -> Iterator[tuple[ast.AST, Callable[[], Undo]]]:
        shown, value = self._parent_of(node), node.value
        if isinstance(value, bool):
            yield shown, _set(node, "value", not value)
        elif isinstance(value, int | float):
            yield shown, _set(node, "value", value + 1)
            if value and isinstance(value, float) and not isinstance(self.up[node], ast.UnaryOp):
                yield shown, _set(node, "value", -value)

    def _calls(self, node: ast.Call) -> Iterator[tuple[ast.AST, Callable[[], Undo]]]:
        f = node.func
        name, of, field = (f.id, f, "id") if isinstance(f, ast.Name) else ("", f, "")
        if isinstance(f, ast.Attribute):
            name, of, field = f.attr, f, "attr"
            if f.attr in ("reduce", "reduceat") and isinstance(f.value, ast.Attribute):
                name, of = f.value.attr, f.value
        if name in SWAPPED:
            yield node, _set(of, field, SWAPPED[name])
        if name == "abs" and len(node.args) == 1:
            yield self._parent_of(node), self._put(node, node.args[0])
        for i, argument in enumerate(node.args):
            if not isinstance(argument, ast.Constant | ast.JoinedStr | ast.Starred):
                yield node, _set(node, "args", [*node.args[:i], _constant(None, argument), *node.args[i + 1 :]])
        for i in range(len(node.keywords) if name != "zip" else 0):
            yield node, _set(node, "keywords", node.keywords[:i] + node.keywords[i + 1 :])

    def _statements(self, node: ast.stmt) -> Iterator[tuple[ast.AST, Callable[[], Undo]]]:
        leave_out = self._put(node, ast.copy_location(ast.Pass(), node))
        holder = Holder(self.up[node], node)
        match node:
            case ast.Expr(value=ast.Call()) | ast.AugAssign() | ast.Raise():
                yield holder, leave_out
            case ast.Return() if node.value is None:
                yield holder, leave_out
            case ast.Return() if isinstance(node.value, ast.Constant) and node.value.value in (None, True, False):
                pass  # changed as a constant, if at all
            case ast.Return() if self._says_yes_or_no(node):
                yield node, _set(node, "value", ast.copy_location(ast.UnaryOp(ast.Not(), node.value), node.value))
            case ast.Return():
                yield node, _set(node, "value", _constant(None, node.value))
            case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
                yield holder, leave_out
            case ast.Assign(targets=[ast.Name(id=name)]) if self._bound_before(node, name):
                yield holder, leave_out
            case ast.Continue() | ast.Break():
                yield holder, leave_out

    def _says_yes_or_no(self, node: ast.stmt) -> bool:
        function = next(n for n in self._above(node) if isinstance(n, FUNCTIONS))
        return function.returns is not None and ast.unparse(function.returns) == "bool"

    def _bound_before(self, node: ast.stmt, name: str) -> bool:
        """Whether the name has a value already where the statement stands in a function."""
        for function in (n for n in self._above(node) if isinstance(n, FUNCTIONS)):
            if any(a.arg == name for a in ast.walk(function.args) if isinstance(a, ast.arg)):
                return True
            stored = (n for n in ast.walk(function) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store))
            return any(n.id == name and n.lineno < node.lineno for n in stored)
        return False

    def _parent_of(self, node: ast.AST) -> ast.AST:
        """What to show, so that the place is known again: the expression or simple statement that it stands in."""
        parent = self.up[node]
        while isinstance(parent, ast.keyword | ast.UnaryOp | ast.Slice | ast.Tuple) or not hasattr(parent, "lineno"):
            if parent is self.tree:
                return parent
            parent = self.up[parent]
        return Head(parent) if hasattr(parent, "body") else parent

    def _put(self, node: ast.AST, new: ast.AST) -> Callable[[], Undo]:
        parent = self.up[node]
        for field, value in ast.iter_fields(parent):
            if value is node:
                return _set(parent, field, new)
            if isinstance(value, list) and any(item is node for item in value):
                return _set(parent, field, [new if item is node else item for item in value])
        raise ValueError("not in its parent")


def _takes_all(pattern: ast.pattern) -> bool:
    return isinstance(pattern, ast.MatchAs) and pattern.pattern is None


def _is_text(node: ast.BinOp | ast.AugAssign) -> bool:
    sides = (node.left, node.right) if isinstance(node, ast.BinOp) else (node.value,)
    return any(
        isinstance(s, ast.JoinedStr) or (isinstance(s, ast.Constant) and isinstance(s.value, str)) for s in sides
    )


def _constant(value: object, where: ast.AST) -> ast.Constant:
    return ast.copy_location(ast.Constant(value), where)  # type: ignore[arg-type]


def _set(node: ast.AST, field: str, new: object) -> Callable[[], Undo]:
    def apply() -> Undo:
        old = getattr(node, field)
        setattr(node, field, new)
        return lambda: setattr(node, field, old)

    return apply
