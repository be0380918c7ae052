"""Finds a checkout's benchmarks and makes a command of each.

A benchmark is a module of the folder `benchmarks` with a function ``run`` whose parameters have defaults. Typer makes
the flags: a parameter ``seeds: int = 10`` is ``--seeds``, ``full: bool = False`` is ``--full / --no-full``. A sequence
is one flag with commas, ``--sizes 150,1000``. Parameters of other types, such as the function that prints, keep their
defaults. There is nothing to register.
"""

from __future__ import annotations

import ast
import functools
import inspect
import math
import os
import sys
import types
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin, get_type_hints

import typer

from he3.errors import InvalidInput
from services.console.cli.options import within
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

_METAVARS: Final = {int: "N", float: "NUMBER", str: "TEXT", Path: "FILE"}
"""The types that a flag can have, and how help names them."""

_PLACES: Final = {"data": "DIR", "folder": "DIR", "out": "DIR", "region": "REGION"}
"""Flags with a path that is no file, and how help names it: as the other commands do."""


def described() -> dict[str, str]:
    """What each benchmark measures, by its name: the first line of its module."""
    _check_checkout()
    names = {module: name for name, module in MODULES.items()}
    found = {}
    for path in sorted((CHECKOUT / FOLDER).glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if any(isinstance(node, ast.FunctionDef) and node.name == "run" for node in tree.body):
            about = (ast.get_docstring(tree) or "").splitlines() or [""]
            found[names.get(path.stem, path.stem).replace("_", "-")] = about[0]
    return found


def command(name: str) -> Any:
    """The command of that benchmark; raises InvalidInput for a name that is not known."""
    return command_of(name, *_benchmark(name))


def command_of(name: str, function: Callable[..., Any], about: str) -> Any:
    """The command of a function with that help; its flags follow from its signature."""
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    further = (inspect.getdoc(function) or "").partition("Raises ")[0].strip()
    app.command(name, help=_as_it_stands(about), epilog=further.replace("``", "`"))(_with_flags(function))
    return typer.main.get_command(app)


def _as_it_stands(text: str) -> str:
    """The text for the help: its indented paragraphs are not wrapped, and it has one kind of quotes."""
    paragraphs = text.replace("``", "`").split("\n\n")
    return "\n\n".join(f"\b\n{each}" if "\n    " in f"\n{each}" else each for each in paragraphs)


def _check_checkout() -> None:
    if not (CHECKOUT / FOLDER).is_dir():
        raise InvalidInput("bench: expected a checkout of the source, got an installed package without benchmarks")
    if str(CHECKOUT) not in sys.path:
        sys.path.insert(0, str(CHECKOUT))


def _benchmark(name: str) -> tuple[Callable[..., Any], str]:
    _check_checkout()
    module_name = MODULES.get(name, name.replace("-", "_"))
    if not module_name.isidentifier() or not (CHECKOUT / FOLDER / f"{module_name}.py").is_file():
        raise InvalidInput(f"bench: expected one of {', '.join(described())}; got '{name}'")
    module = import_module(f"{FOLDER}.{module_name}")
    function = getattr(module, "run", None)
    if not callable(function):
        raise InvalidInput(f"bench: expected a benchmark, got {module_name}, a part of other benchmarks")
    return function, inspect.getdoc(module) or ""


def _with_flags(function: Callable[..., Any]) -> Callable[..., None]:
    """The function with a signature that Typer turns into flags; output paths are checked before it runs."""

    @functools.wraps(function)
    def run(**arguments: Any) -> None:
        _check_place(arguments.get("json"))
        if arguments.get("out") is not None:
            make_folder(arguments["out"])
        function(**arguments)

    hints = get_type_hints(function)
    flags = [
        flag
        for each in inspect.signature(function).parameters.values()
        if (flag := _flag(each, hints.get(each.name, str))) is not None
    ]
    run.__signature__ = inspect.Signature(flags)  # type: ignore[attr-defined]
    run.__annotations__ = {flag.name: flag.annotation for flag in flags}
    return run


def _flag(parameter: inspect.Parameter, kind: Any) -> inspect.Parameter | None:
    """The parameter as a Typer flag; None if it has no flag."""
    default, metavar = parameter.default, None
    kinds = [part for part in get_args(kind) if part is not type(None)] if _is_union(kind) else [kind]
    optional = _is_union(kind) and type(None) in get_args(kind)
    # Typer knows no unions but with None; a `Path | str` is a path.
    chosen = Path if Path in kinds else kinds[0]
    options: dict[str, Any] = {}
    if _is_sequence(chosen):
        item = get_args(chosen)[0]
        if item not in _METAVARS:
            return None
        metavar, options["parser"] = f"{_METAVARS[item]},...", _list_of(item)
        default = None if default is None else ",".join(map(str, default))
        chosen = str
    elif chosen in _METAVARS:
        options["callback"] = within(0, math.inf) if chosen in (int, float) else None
        metavar = _PLACES.get(parameter.name, _METAVARS[chosen]) if chosen is Path else _METAVARS[chosen]
    elif chosen is not bool and get_origin(chosen) is not Literal:
        return None
    flag = f"--{parameter.name.replace('_', '-')}"
    names = f"{flag}/--no-{flag[2:]}" if chosen is bool else flag
    wanted: Any = chosen | None if optional else chosen
    annotation: Any = Annotated[wanted, typer.Option(names, metavar=metavar, **options)]
    return inspect.Parameter(parameter.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _is_union(kind: Any) -> bool:
    return get_origin(kind) in (Union, types.UnionType)


def _is_sequence(kind: Any) -> bool:
    origin = get_origin(kind)
    return isinstance(origin, type) and issubclass(origin, Sequence)


def _list_of(item: type) -> Callable[[str], Any]:
    """A parser of comma-separated values."""

    def parse(text: str) -> Any:
        try:
            return tuple(item(part) for part in text.split(",") if part)
        except ValueError:
            raise typer.BadParameter(f"expected {_METAVARS[item]},..., got '{text}'") from None

    return parse


def _check_place(result: Path | None) -> None:
    """Make the folder of the result; raise InvalidInput if the result cannot be written there."""
    if result is None:
        return
    folder = make_folder(result.parent)
    if result.is_dir() or not os.access(result if result.exists() else folder, os.W_OK):
        raise InvalidInput(f"--json: expected a file that can be written, got {result}")
