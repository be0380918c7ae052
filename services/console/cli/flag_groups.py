"""Groups of flags that several commands share, each written once as a dataclass.

A command takes the group as one parameter, and `with_flags` puts the group's flags in its place:

    @dataclass(frozen=True, slots=True)
    class Session(FlagGroup):
        mission: Mission = None
        earth: Earth = None

    @app.command()
    @with_flags
    def show(session: Session, json: AsJson = False) -> None: ...

The command line then has --json, --mission and --earth; a group's flags come after the command's own.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, get_type_hints


@dataclass(frozen=True, slots=True)
class FlagGroup:
    """The values of a group of flags. Each field is annotated as a flag and has a default."""


def with_flags(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the flags of each group that it takes, in the place of the group."""
    own = inspect.signature(command, eval_str=True)
    groups = {name: each.annotation for name, each in own.parameters.items() if _is_group(each.annotation)}
    kept = [each for name, each in own.parameters.items() if name not in groups]
    flags = [flag for group in groups.values() for flag in _flags(group)]

    @functools.wraps(command)
    def with_groups(**values: Any) -> None:
        made = {name: group(**{f.name: values.pop(f.name) for f in fields(group)}) for name, group in groups.items()}
        command(**made, **values)

    shown = own.replace(parameters=[*kept, *flags])
    with_groups.__signature__ = shown  # type: ignore[attr-defined]
    with_groups.__annotations__ = {name: each.annotation for name, each in shown.parameters.items()}
    return with_groups


def _is_group(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, FlagGroup)


def _flags(group: type[FlagGroup]) -> list[inspect.Parameter]:
    """A parameter for each field. Keyword-only, because the command's own may have no default."""
    hints = get_type_hints(group, include_extras=True)
    return [
        inspect.Parameter(
            field.name, inspect.Parameter.KEYWORD_ONLY, default=field.default, annotation=hints[field.name]
        )
        for field in fields(group)
    ]
