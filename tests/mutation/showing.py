"""How a place in a module is shown, so that somebody knows it again: an expression, the head of a statement, a statement."""

from __future__ import annotations

import ast


class Head(ast.AST):
    """Shown without what is in it."""

    def __init__(self, node: ast.AST) -> None:
        self.node = node


class Holder(ast.AST):
    """A statement, shown as what stands in its place."""

    def __init__(self, parent: ast.AST, node: ast.stmt) -> None:
        self.parent = parent
        for field, value in ast.iter_fields(parent):
            if isinstance(value, list) and any(item is node for item in value):
                self.field, self.index = field, next(i for i, item in enumerate(value) if item is node)


def shown_as(node: ast.AST) -> str:
    match node:
        case Holder():
            return " ".join(ast.unparse(getattr(node.parent, node.field)[node.index]).split())
        case Head(node=ast.match_case() as case):
            return f"case {ast.unparse(case.pattern)}" + (f" if {ast.unparse(case.guard)}" if case.guard else "")
        case Head(node=ast.IfExp() as inner):
            return f"... if {ast.unparse(inner.test)}"
        case Head(node=ast.If() | ast.While() as inner):
            return f"{type(inner).__name__.lower()} {ast.unparse(inner.test)}"
        case Head():
            return " ".join(ast.unparse(node.node).split(":\n")[0].split())
    return " ".join(ast.unparse(node).split())
