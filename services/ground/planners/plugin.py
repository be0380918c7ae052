"""Plug-in planners: functions that users write, found by name.

``module:function`` is a function of a module in the working directory or on Python's path, which takes a
``PlanningRequest`` and returns a ``PlannedRound``. It is imported with its output sent to the log, and whatever it
raises is reported in one line. Its answers are validated as ours are (``services.ground.planners.validation``).
"""

from __future__ import annotations

import sys
import traceback
from contextlib import redirect_stdout
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from he3.errors import InvalidInput, NoRoute
from services.ground.planners.validation import error_text

if TYPE_CHECKING:
    from services.ground.planners.interface import PlannedRound, Planner, PlanningRequest


def load_plugin(name: str) -> Planner:
    """The planner of that name; raises InvalidInput if there is none.

    What it prints goes to the log. Whatever it raises but NoRoute, an exit included, becomes InvalidInput in one line.
    """
    module, _, function = name.partition(":")
    if not (module and function):
        raise InvalidInput(f"expected a planner as module:function, got {name!r}")
    try:
        with redirect_stdout(sys.stderr):
            _look_in_working_directory(module)
            found = import_module(module)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - importing a plug-in may raise anything
        raise InvalidInput(f"planner {name}: expected a module to import from the working directory or Python's path, "
                           f"got {error_text(error)}") from None  # fmt: skip
    planner = getattr(found, function, None)
    if not callable(planner):
        came = "none" if planner is None else type(planner).__name__
        raise InvalidInput(f"planner {name}: expected a function {function} in {module}, got {came}")
    return partial(_guarded, name, planner)


def _look_in_working_directory(module: str) -> None:
    """Let a module that is not on Python's path be found in the working directory, and with it what it imports there.

    The directory is the last place: no module of ours, of Python's or of an installed package is taken from there.
    """
    here = str(Path.cwd())
    if here not in sys.path and find_spec(module.partition(".")[0]) is None:
        sys.path.append(here)


def _guarded(name: str, planner: Planner, request: PlanningRequest) -> PlannedRound:
    """The planner's answer; raises NoRoute as the planner does, and InvalidInput for any other exception."""
    try:
        return planner(request)
    except NoRoute:
        raise
    except (Exception, SystemExit) as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        raise InvalidInput(
            f"planner {name}: expected a PlannedRound or NoRoute, got {error_text(error)} "
            f"({Path(where.filename).name}, line {where.lineno})"
        ) from error
