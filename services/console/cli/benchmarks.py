"""Finds a checkout's benchmarks and turns flags into the arguments of their ``run`` functions.

A benchmark is a module of the folder `benchmarks` with a function ``run`` whose parameters have defaults; a parameter
``seeds: int = 10`` is the flag ``--seeds N``, ``full: bool = False`` is ``--full``, a sequence is ``--sizes 150,1000``.
Parameters that are no plain values (what to print with, say) are left alone. There is nothing to register.
"""

from __future__ import annotations

import ast
import inspect
import os
import sys
import types
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Final, Literal, Union, get_args, get_origin, get_type_hints

from he3.errors import InvalidInput
from services.console.report.outputs import make_folder

CHECKOUT: Final = Path(__file__).resolve().parents[3]
FOLDER: Final = "benchmarks"

MODULES: Final = {
    "link": "link_timing",
    "lockstep": "lockstep_speed",
    "map": "map_speed",
    "operator": "operator_load",
    "planners": "planners_speed",
}
"""Benchmarks whose module has another name."""

_PLAIN: Final = (int, float, Path, str)
"""Types of a flag's value, in the order in which they are tried."""


def listing() -> list[str]:
    """A line for each benchmark: its name and what it measures."""
    _checkout()
    names = {module: name for name, module in MODULES.items()}
    lines = ["Benchmarks:"]
    for path in sorted((CHECKOUT / FOLDER).glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if any(isinstance(node, ast.FunctionDef) and node.name == "run" for node in tree.body):
            about = (ast.get_docstring(tree) or "").splitlines() or [""]
            lines.append(f"  {names.get(path.stem, path.stem).replace('_', '-'):<14} {about[0]}")
    return lines


def run_benchmark(name: str, words: Sequence[str], say: Callable[[str], Any]) -> None:
    """Run the benchmark of that name with those flags; raises InvalidInput for a name or flag that is not known."""
    function, about = _benchmark(name)
    if "--help" in words or "-h" in words:
        parts = (f"Usage: he3 bench {name} [OPTIONS]", about.strip(), "Options:\n" + "\n".join(_flags(function)),
                 (inspect.getdoc(function) or "").partition("Raises ")[0].strip())  # fmt: skip
        say("\n\n".join(part for part in parts if part))
        return
    arguments = arguments_of(function, words)
    _check_place(arguments.get("json"))
    if isinstance(arguments.get("out"), Path):
        make_folder(arguments["out"])
    function(**arguments)


def _check_place(result: Path | None) -> None:
    """Say now, not after half an hour of measuring, that the result cannot be written; its folder is made."""
    if result is None:
        return
    folder = make_folder(result.parent)
    if result.is_dir() or not os.access(result if result.exists() else folder, os.W_OK):
        raise InvalidInput(f"json: expected a file that can be written, got {result}")


def _checkout() -> None:
    if not (CHECKOUT / FOLDER).is_dir():
        raise InvalidInput("he3 bench: expected a checkout of the source, got an installed package without benchmarks")
    if str(CHECKOUT) not in sys.path:
        sys.path.insert(0, str(CHECKOUT))


def _benchmark(name: str) -> tuple[Callable[..., Any], str]:
    _checkout()
    module_name = MODULES.get(name, name.replace("-", "_"))
    if not module_name.isidentifier() or not (CHECKOUT / FOLDER / f"{module_name}.py").is_file():
        known = ", ".join(line.split()[0] for line in listing()[1:])
        raise InvalidInput(f"he3 bench: expected one of {known}; got '{name}'")
    module = import_module(f"{FOLDER}.{module_name}")
    function = getattr(module, "run", None)
    if not callable(function):
        raise InvalidInput(f"he3 bench: {module_name} is a part of other benchmarks, not one to run")
    return function, inspect.getdoc(module) or ""


def arguments_of(function: Callable[..., Any], words: Sequence[str]) -> dict[str, Any]:
    """Keyword arguments of the function from ``--flag value`` words; raises InvalidInput with one line."""
    kinds = _parameters(function)
    arguments: dict[str, Any] = {}
    rest = list(words)
    while rest:
        word = rest.pop(0)
        flag, equals, value = word.partition("=")
        key = flag.removeprefix("--").replace("-", "_")
        negated = key.removeprefix("no_")
        if not flag.startswith("--") or (key not in kinds and negated not in kinds):
            known = ", ".join(f"--{name.replace('_', '-')}" for name in kinds)
            raise InvalidInput(f"bench: expected a flag out of {known}; got '{word}'")
        if key not in kinds or kinds[key] is bool:
            arguments[negated if key not in kinds else key] = key in kinds
            continue
        if not equals:
            if not rest:
                raise InvalidInput(f"bench: expected a value after {flag}, got none")
            value = rest.pop(0)
        arguments[key] = _value(flag, value, kinds[key])
    return arguments


def _parameters(function: Callable[..., Any]) -> dict[str, Any]:
    """Type of each parameter that a flag can set."""
    hints = get_type_hints(function)
    parameters = inspect.signature(function).parameters
    return {name: hints.get(name, str) for name in parameters if _settable(hints.get(name, str))}


def _settable(kind: Any) -> bool:
    origin = get_origin(kind)
    if origin in (Union, types.UnionType):
        return any(_settable(part) for part in get_args(kind))
    if origin is Literal or kind is bool:
        return True
    if origin is not None and isinstance(origin, type) and issubclass(origin, Sequence):
        return _settable(get_args(kind)[0])
    return kind in _PLAIN


def _value(flag: str, text: str, kind: Any) -> Any:
    origin = get_origin(kind)
    if origin in (Union, types.UnionType):
        parts = [part for part in get_args(kind) if part is not type(None)]
        for part in sorted(parts, key=lambda each: _PLAIN.index(each) if each in _PLAIN else -1):
            try:
                return _value(flag, text, part)
            except InvalidInput:
                continue
        raise InvalidInput(f"bench: {flag}: expected {_named(kind)}, got '{text}'")
    if origin is Literal:
        if text not in get_args(kind):
            raise InvalidInput(f"bench: {flag}: expected one of {', '.join(map(str, get_args(kind)))}; got '{text}'")
        return text
    if origin is not None:
        return tuple(_value(flag, part, get_args(kind)[0]) for part in text.split(",") if part)
    try:
        return kind(text)
    except ValueError:
        raise InvalidInput(f"bench: {flag}: expected {_named(kind)}, got '{text}'") from None


def _flags(function: Callable[..., Any]) -> list[str]:
    defaults = inspect.signature(function).parameters
    lines = []
    for name, kind in _parameters(function).items():
        default = defaults[name].default
        shown = ",".join(map(str, default)) if isinstance(default, tuple | list) else default
        word = name.replace("_", "-")
        if kind is bool:
            lines.append(f"  --no-{word}" if default else f"  --{word}")
            continue
        said = default is not None and default is not inspect.Parameter.empty
        value = "FOLDER" if name == "out" else _named(kind)
        lines.append(f"  {f'--{word} {value}':<34} {f'default: {shown}' if said else ''}".rstrip())
    return lines


def _named(kind: Any) -> str:
    if get_origin(kind) in (Union, types.UnionType):
        return "|".join(_named(part) for part in get_args(kind) if part is not type(None))
    if get_origin(kind) is Literal:
        return "|".join(map(str, get_args(kind)))
    if get_origin(kind) is not None:
        return f"{_named(get_args(kind)[0])},..."
    return {int: "N", float: "NUMBER", str: "TEXT", Path: "FILE"}.get(kind, str(kind))
