"""The shape of the code in figures: levels of imports, circles, long classes, unused and duplicate code.

Imports come from grimp, which import-linter brings; unused definitions from vulture, whose exceptions stand in
pyproject.toml, each with its reason; classes and duplicates from the syntax tree. An import inside of a function or for
type checking alone counts like any other: it, too, is something that a reader has to follow.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import keyword
import os
import re
import subprocess
import sys
import tokenize
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import grimp

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("he3", "schemas", "services")
RUNTIME = "services.runtime"
LONGEST = 10
WINDOW = 60
"""Tokens of a function's body that two places must have in common, names aside, to count as duplicates."""

TARGETS: dict[str, int] = {
    "modules at the top of services": 0,
    "levels of imports": 14,
    "levels of services.runtime": 6,
    "import circles": 0,
    "unused definitions": 0,
}

Imports = dict[str, set[str]]


@dataclass(frozen=True, slots=True)
class LongClass:
    """A class, where it is, and how long it is with its docstring."""

    name: str
    place: str
    lines: int
    methods: int


@dataclass(frozen=True, slots=True)
class Duplicate:
    """Two places whose bodies say the same, but for the names."""

    tokens: int
    first: str
    second: str


@dataclass(frozen=True, slots=True)
class Structure:
    """Everything that is reported. Chains run from the importing module to the one that imports nothing."""

    top_modules: list[str]
    chain: list[str]
    runtime_chain: list[str]
    circles: list[list[str]]
    longest_classes: list[LongClass]
    unused: list[str]
    duplicates: list[Duplicate]

    def figures(self) -> dict[str, int]:
        """The figures that have a target, and the number of duplicates."""
        return {
            "modules at the top of services": len(self.top_modules),
            "levels of imports": len(self.chain),
            "levels of services.runtime": len(self.runtime_chain),
            "import circles": len(self.circles),
            "unused definitions": len(self.unused),
            "duplicate blocks": len(self.duplicates),
        }


def measure(root: Path) -> Structure:
    """The structure of the repository whose working tree is `root`."""
    imports = imports_of(root)
    runtime = packages_within(imports, RUNTIME)
    sources = {path: path.read_text(encoding="utf-8") for path in modules_of(root)}
    return Structure(
        top_modules=sorted(path.name for path in (root / "services").glob("*.py") if path.stem != "__init__"),
        chain=longest_chain(imports),
        runtime_chain=longest_chain(runtime),
        circles=circles_of(imports) + circles_of(runtime),
        longest_classes=longest_classes(root, sources),
        unused=unused_in(root),
        duplicates=duplicates_in(root, sources),
    )


def modules_of(root: Path) -> list[Path]:
    """Every Python file of the packages."""
    return [path for package in PACKAGES for path in sorted((root / package).rglob("*.py"))]


def imports_of(root: Path) -> Imports:
    """The imports among the packages' modules at run time: imports for annotations alone do not count."""
    sys.path.insert(0, str(root))
    graph = grimp.build_graph(*PACKAGES, cache_dir=None, exclude_type_checking_imports=True)
    return {module: set(graph.find_modules_directly_imported_by(module)) for module in graph.modules}


def packages_within(imports: Imports, package: str) -> Imports:
    """The imports among the direct children of `package`, each taken as a whole."""

    def child(module: str) -> str | None:
        inner = module.removeprefix(package + ".")
        return None if inner == module else f"{package}.{inner.split('.')[0]}"

    children: Imports = defaultdict(set)
    for module, imported in imports.items():
        if (own := child(module)) is not None:
            children[own] |= {other for name in imported if (other := child(name)) is not None and other != own}
    return dict(children)


def components(imports: Imports) -> list[list[str]]:
    """Strongly connected components, a module after all that it imports (Tarjan 1972)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(module: str) -> None:
        index[module] = low[module] = len(index)
        stack.append(module)
        for other in sorted(imports[module]):
            if other not in index:
                visit(other)
            if other in stack:
                low[module] = min(low[module], low[other])
        if low[module] == index[module]:
            cut = stack.index(module)
            found.append(sorted(stack[cut:]))
            del stack[cut:]

    for module in sorted(imports):
        if module not in index:
            visit(module)
    return found


def circles_of(imports: Imports) -> list[list[str]]:
    """Groups of modules that import one another."""
    return [group for group in components(imports) if len(group) > 1]


def longest_chain(imports: Imports) -> list[str]:
    """The longest chain of imports. A circle counts as one level, named after its first module."""
    chain_of: dict[str, list[str]] = {}
    for group in components(imports):
        below = [chain_of[other] for module in group for other in sorted(imports[module]) if other not in group]
        chain = [group[0], *max(below, key=len, default=[])]
        chain_of.update(dict.fromkeys(group, chain))
    return max(chain_of.values(), key=len, default=[])


def longest_classes(root: Path, sources: dict[Path, str]) -> list[LongClass]:
    """The ten longest classes."""
    classes = [
        LongClass(
            node.name,
            f"{path.relative_to(root)}:{node.lineno}",
            (node.end_lineno or node.lineno) - node.lineno + 1,
            sum(isinstance(part, ast.FunctionDef | ast.AsyncFunctionDef) for part in node.body),
        )
        for path, source in sources.items()
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.ClassDef)
    ]
    return sorted(classes, key=lambda one: -one.lines)[:LONGEST]


_MESSAGE_FIELD = re.compile(r"schemas/\w+\.py:\d+: unused variable ")
"""A field of a message is used by its receiver, which may be a client of other authors."""


def unused_in(root: Path) -> list[str]:
    """Definitions that nothing but a test uses, by vulture."""
    command = [sys.executable, "-m", "vulture", "--config", str(ROOT / "pyproject.toml")]
    ended = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    if ended.returncode not in (0, 3):  # 3: it found some
        raise SystemExit(
            f"structure: expected vulture to run, got exit code {ended.returncode}: {ended.stderr.strip()}"
        )
    return [line for line in ended.stdout.splitlines() if not _MESSAGE_FIELD.match(line)]


@dataclass(frozen=True, slots=True)
class _Token:
    text: str
    line: int
    column: int
    is_name: bool
    is_literal: bool


def duplicates_in(root: Path, sources: dict[Path, str]) -> list[Duplicate]:
    """Pairs of places in function bodies with the same tokens, names and literals aside; longest first."""
    bodies = [(path, tokens) for path, source in sources.items() for tokens in _function_bodies(source)]
    windows: dict[tuple[str, ...], list[tuple[int, int]]] = defaultdict(list)
    for body, (_, tokens) in enumerate(bodies):
        for at in range(len(tokens) - WINDOW + 1):
            windows[_shape(tokens[at : at + WINDOW])].append((body, at))
    starts: dict[tuple[int, int, int], list[int]] = defaultdict(list)
    for places in windows.values():
        for number, (body, at) in enumerate(places):
            for other, there in places[number + 1 :]:
                if body != other or there - at >= WINDOW:
                    starts[body, other, there - at].append(at)
    found = []
    for (body, other, shift), ats in starts.items():
        (path, tokens), (there, theirs) = bodies[body], bodies[other]
        for first, last in _runs(sorted(ats)):
            end = last + WINDOW - 1
            found.append(
                Duplicate(
                    end - first + 1,
                    f"{path.relative_to(root)}:{tokens[first].line}-{tokens[end].line}",
                    f"{there.relative_to(root)}:{theirs[first + shift].line}-{theirs[end + shift].line}",
                )
            )
    return sorted(found, key=lambda one: -one.tokens)


def _function_bodies(source: str) -> Iterator[list[_Token]]:
    """The tokens of each outermost function, without its signature, docstring, comments and line ends."""
    layout = {
        tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER,
    }  # fmt: skip
    tokens = [
        _Token(
            one.string,
            *one.start,
            one.type == tokenize.NAME and not keyword.iskeyword(one.string),
            one.type in (tokenize.STRING, tokenize.NUMBER),
        )
        for one in tokenize.generate_tokens(io.StringIO(source).readline)
        if one.type not in layout
    ]
    for function in _outermost_functions(ast.parse(source)):
        body = function.body[1:] if ast.get_docstring(function) is not None else function.body
        if body:
            first, last = (body[0].lineno, body[0].col_offset), function.end_lineno or body[-1].lineno
            yield [token for token in tokens if first <= (token.line, token.column) and token.line <= last]


def _outermost_functions(tree: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node
        else:
            yield from _outermost_functions(node)


def _shape(window: list[_Token]) -> tuple[str, ...]:
    """The window with each name replaced by the number of its first occurrence, and literals by one mark."""
    numbers: dict[str, str] = {}
    return tuple(
        numbers.setdefault(token.text, f"n{len(numbers)}") if token.is_name else "#" if token.is_literal else token.text
        for token in window
    )


def _runs(numbers: list[int]) -> Iterator[tuple[int, int]]:
    """First and last of each run of consecutive numbers."""
    first = last = numbers[0]
    for number in numbers[1:]:
        if number != last + 1:
            yield first, last
            first = number
        last = number
    yield first, last


def report(structure: Structure) -> Iterator[str]:
    """The lines that are printed."""
    for name, figure in structure.figures().items():
        target = TARGETS.get(name)
        verdict = "" if target is None else f"   target {target}" + ("" if figure <= target else "   MISSED")
        yield f"{name:32}{figure:5d}{verdict}"
    yield from _section("modules at the top of services", structure.top_modules, str)
    yield from _section("longest chain of imports", structure.chain, str)
    yield from _section("longest chain of imports within services.runtime", structure.runtime_chain, str)
    yield from _section("import circles", structure.circles, " <-> ".join)
    yield from _section(
        f"the {LONGEST} longest classes (lines, methods)",
        structure.longest_classes,
        lambda one: f"{one.lines:5d} {one.methods:4d}  {one.name}  {one.place}",
    )
    yield from _section("unused definitions", structure.unused, str)
    yield from _section(
        f"duplicate blocks (tokens, at least {WINDOW})",
        structure.duplicates,
        lambda one: f"{one.tokens:5d}  {one.first}  {one.second}",
    )


def _section(title: str, items: Iterable[Any], line: Callable[[Any], str]) -> Iterator[str]:
    yield ""
    yield f"{title}:"
    shown = [f"  {line(item)}" for item in items]
    yield from shown or ["  none"]


def main() -> int:
    """Print the structure; 1 if --check was given and a target is missed."""
    parser = argparse.ArgumentParser(prog="scripts/structure", description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("root", nargs="?", type=Path, default=ROOT, help="another working tree of the project")
    parser.add_argument("--json", action="store_true", help="as JSON")
    parser.add_argument("--check", action="store_true", help="exit with 1 when a figure misses its target")
    asked = parser.parse_args()
    structure = measure(asked.root.resolve())
    figures = structure.figures()
    if asked.json:
        text = json.dumps({"figures": figures, "targets": TARGETS, **asdict(structure)}, indent=1)
    else:
        text = "\n".join(report(structure))
    try:
        print(text, flush=True)
    except BrokenPipeError:  # a reader such as `head` wants no more; nor may Python's own last flush fail
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return int(asked.check and any(figures[name] > target for name, target in TARGETS.items()))


if __name__ == "__main__":
    sys.exit(main())
