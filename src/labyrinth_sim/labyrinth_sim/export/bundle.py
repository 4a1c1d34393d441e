# SPDX-License-Identifier: Apache-2.0
"""Functions of effects and drives, with everything of ours that they use, as text that needs only numpy and mujoco."""

import ast
import inspect
import sys
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

from labyrinth_sim.errors import InputError

OURS = "labyrinth_sim"
# What the runtime has of its own.
SHIMS = {("labyrinth_sim.normal", "ndtr"): "ndtr", ("labyrinth_sim.law", "state"): "state"}
GIVEN = {"numpy": "np", "mujoco": "mujoco", "math": "math"}


class Bundle:
    """Collects definitions; each has one name in the text, that of its file and its own."""

    def __init__(self) -> None:
        self._done: dict[tuple[str, str], str] = {}
        self._text: list[str] = []

    @property
    def text(self) -> str:
        """The definitions, each after those that it uses."""
        return "\n\n".join(self._text)

    def add(self, function: Callable[..., Any] | None) -> str | None:
        """The name that a function has in the text; None for None.

        Raises:
            InputError: it is no plain function of a file, or uses what only some library has.
        """
        if function is None:
            return None
        name, file = getattr(function, "__qualname__", ""), inspect.getsourcefile(function)
        if file is None or not name.isidentifier():
            raise InputError(f"{function}: only functions of a file by a name of their own can be exported.")
        return self._define(file, name)

    def name_of(self, file: str, name: str) -> str:
        """A definition's name in the text, for a class or function of a file."""
        return self._define(file, name)

    def _define(self, file: str, name: str) -> str:
        key = (file, name)
        if key in self._done:
            return self._done[key]
        tree = _parsed(file, Path(file).stat().st_mtime_ns)
        node = next((n for n in tree.body if name in _defines(n)), None)
        if node is None:
            raise InputError(f"{file}: '{name}' is not defined at its top level, so it cannot be exported.")
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == OURS:
            self._done[key] = self._define(_file_of(node.module or ""), name)
            return self._done[key]
        self._done[key] = own = f"{Path(file).stem}_{name}".lstrip("_")
        renamed = _Renamed(self, file, tree)
        copied = ast.parse(ast.unparse(node)).body[0]
        shown = ast.fix_missing_locations(renamed.visit(copied))
        if isinstance(shown, ast.FunctionDef | ast.ClassDef):
            shown.name = own
        self._text.append(ast.unparse(shown))
        return own


@lru_cache(maxsize=64)
def _parsed(file: str, _version: int) -> ast.Module:
    return ast.parse(Path(file).read_text(encoding="utf-8"), file)


def _defines(node: ast.stmt) -> list[str]:
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return [node.name]
    if isinstance(node, ast.Assign):
        return [t.id for t in node.targets if isinstance(t, ast.Name)]
    if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
        return [node.target.id]
    if isinstance(node, ast.ImportFrom | ast.Import):
        return [alias.asname or alias.name for alias in node.names]
    return []


def _file_of(module: str) -> str:
    found = sys.modules[module].__file__
    assert found is not None
    return found


class _Renamed(ast.NodeTransformer):
    """Gives names of the file's top level their names in the bundle, and takes annotations away."""

    def __init__(self, bundle: Bundle, file: str, tree: ast.Module) -> None:
        self._bundle, self._file = bundle, file
        self._top = {name: node for node in tree.body for name in _defines(node)}
        self._locals: list[set[str]] = []

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.returns = None
        node.decorator_list = []  # a law and what it calls are plain functions, too; compiled they are only faster
        arguments = [*node.args.args, *node.args.kwonlyargs, *node.args.posonlyargs]
        for argument in arguments:
            argument.annotation = None
        stored = {n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
        self._locals.append({a.arg for a in arguments} | stored)
        self.generic_visit(node)
        self._locals.pop()
        return node

    def visit_Lambda(self, node: ast.Lambda) -> ast.AST:
        self._locals.append({a.arg for a in node.args.args})
        self.generic_visit(node)
        self._locals.pop()
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST | None:
        if node.value is None:
            return None
        plain = ast.Assign(targets=[node.target], value=node.value)
        return self.generic_visit(ast.copy_location(plain, node))

    def visit_Name(self, node: ast.Name) -> ast.AST:
        name = node.id
        if any(name in known for known in self._locals) or name not in self._top:
            return node
        home = self._top[name]
        if isinstance(home, ast.Import):
            module = next(a.name for a in home.names if (a.asname or a.name) == name)
            if GIVEN.get(module) != name:
                raise InputError(
                    f"{self._file}: uses '{module}', which an exported module cannot; numpy and mujoco can."
                )
            return node
        if isinstance(home, ast.ImportFrom):
            module = home.module or ""
            if (module, name) in SHIMS:
                return ast.copy_location(ast.Name(SHIMS[module, name], node.ctx), node)
            if module.split(".")[0] != OURS:
                raise InputError(
                    f"{self._file}: uses '{module}', which an exported module cannot; numpy and mujoco can."
                )
        return ast.copy_location(ast.Name(self._bundle.name_of(self._file, name), node.ctx), node)
