"""What a compiled function depends on: a digest of its source and of all that it uses by name.

A kernel's machine code holds the kernels that it calls and the constants that it reads. The digest
follows these names from definition to definition, through the imports of this package. Comments,
docstrings, lines that moved, and the rest of the modules do not count.
"""

from __future__ import annotations

import ast
import hashlib
import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parent  # folder of the package
DECORATORS = ("njit", "inner", "lean")  # names of the decorators that make a function a kernel


class Name(NamedTuple):
    """A name at the top level of a module."""

    file: Path
    name: str  # empty: what the module does without binding a name
    whole: bool = False  # whether all that the module defines is meant


@dataclass
class _Definition:
    """What binds a name at the top level of a module."""

    text: str = ""  # syntax trees of the statements
    uses: set[str] = field(default_factory=set)  # names
    imports: set[Name] = field(default_factory=set)

    def add(self, statement: ast.stmt) -> None:
        """Add a statement."""
        stripped = _Stripped().visit(statement)
        self.text += ast.dump(stripped)
        for node in ast.walk(stripped):
            match node:
                case ast.ImportFrom():
                    self.imports |= {target for _, target in _imported(node)}
                case ast.Name(id=name) | ast.Constant(value=str() as name):  # or a type in quotes
                    self.uses.add(name)


class _Stripped(ast.NodeTransformer):
    """Leaves out docstrings, and the decorator that the compiler stands for."""

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        """Drop a constant that stands alone."""
        return None if isinstance(node.value, ast.Constant) else node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        """Drop the decorator of kernels."""
        node.decorator_list = [d for d in node.decorator_list if not _marks_kernel(d)]
        return self.generic_visit(node)


def _marks_kernel(decorator: ast.expr) -> bool:
    return isinstance(decorator, ast.Name) and decorator.id in DECORATORS


def _imported(node: ast.ImportFrom) -> Iterator[tuple[str, Name]]:
    """Yield what an import binds to names of this package."""
    package, *parts = (node.module or "").split(".")
    if package == ROOT.name and not node.level:
        for alias in node.names:
            bound = alias.asname or alias.name
            if module := _file_of(ROOT.joinpath(*parts, alias.name)):
                yield bound, Name(module, "", whole=True)
            elif module := _file_of(ROOT.joinpath(*parts)):
                yield bound, Name(module, alias.name)


def _file_of(place: Path) -> Path | None:
    """Return the file of a module or a package; None where there is none."""
    candidates = place.with_suffix(".py"), place / "__init__.py"
    return next((file for file in candidates if file.is_file()), None)


@cache
def _definitions(file: Path) -> dict[str, _Definition]:
    """Return what a module defines at its top level."""
    found = {"": _Definition()}

    def collect(statements: Iterable[ast.stmt]) -> None:
        for statement in statements:
            match statement:
                case ast.ImportFrom():
                    for bound, target in _imported(statement):
                        found.setdefault(bound, _Definition()).imports.add(target)
                case ast.Import() | ast.Expr(value=ast.Constant()):
                    pass
                case ast.If(test=ast.Name(id="TYPE_CHECKING"), body=body):
                    collect(body)
                case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                    found.setdefault(name, _Definition()).add(statement)
                case _:
                    for name in _stored(statement) or {""}:
                        found.setdefault(name, _Definition()).add(statement)

    collect(ast.parse(file.read_bytes()).body)
    return found


def _stored(statement: ast.stmt) -> set[str]:
    """Return the names that a statement binds."""
    nodes = [node for node in ast.walk(statement) if isinstance(node, ast.Name)]
    return {node.id for node in nodes if isinstance(node.ctx, ast.Store)}


def source_digest(file: Path, name: str) -> str:
    """Return a digest of a function of a module, and of all of this package that it uses."""
    found: dict[Name, str] = {}
    pending = [Name(file, name)]
    while pending:
        if (place := pending.pop()) in found:
            continue
        known = _definitions(place.file)
        if place.whole or place.name not in known:  # as where names are loaded lazily
            found[place] = ""
            pending += [Name(place.file, each) for each in known]
        else:
            definition = known[place.name]
            found[place] = definition.text
            pending += [Name(place.file, each) for each in {"", *definition.uses} if each in known]
            pending += definition.imports
    texts = sorted((os.path.relpath(p.file, ROOT), p.name, text) for p, text in found.items())
    return hashlib.sha256(repr(texts).encode()).hexdigest()[:24]


def kernels_of(file: Path) -> list[str]:
    """Return the names of the kernels that a module defines."""
    decorated = rf"^@({'|'.join(DECORATORS)})$"
    if not re.search(decorated, file.read_text(encoding="utf-8"), re.MULTILINE):
        return []
    return [
        statement.name
        for statement in ast.parse(file.read_bytes()).body
        if isinstance(statement, ast.FunctionDef)
        and any(map(_marks_kernel, statement.decorator_list))
    ]


def module_of(file: Path) -> str:
    """Return the name of a module of this package."""
    return ".".join(file.relative_to(ROOT.parent).with_suffix("").parts).removesuffix(".__init__")


def sources() -> list[Path]:
    """Return the files of all modules of this package."""
    return sorted(ROOT.rglob("*.py"))
