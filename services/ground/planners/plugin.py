"""Plug-in planners: functions that users write, found by name.

``module:function`` is a function of a module in the working directory or on Python's path, which takes a
``PlanningRequest`` and returns a ``PlannedRound``. Only the user names one: one that a scenario's file names is refused
without ``--allow-plugin`` (`services.runtime.options`). It is imported with its output sent to the log, and any
exception is reported in one line. Its answers are validated as ours are (``services.ground.planners.validation``).
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
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

    Its output goes to the log. Any exception but NoRoute, SystemExit included, becomes InvalidInput with one line.
    """
    module, _, function = name.partition(":")
    if not (module and function):
        raise InvalidInput(f"expected a planner as module:function, got {name!r}")
    try:
        with redirect_stdout(sys.stderr), _working_directory_for(module):
            found = import_module(module)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - importing a plug-in may raise anything
        raise InvalidInput(f"planner {name}: expected a module to import from the working directory or Python's path, "
                           f"got {error_text(error)}") from None  # fmt: skip
    planner = getattr(found, function, None)
    if not callable(planner):
        came = "none" if planner is None else type(planner).__name__
        raise InvalidInput(f"planner {name}: expected a function {function} in {module}, got {came}")
    return partial(_guarded, name, planner)


@contextmanager
def _working_directory_for(module: str) -> Iterator[None]:
    """Within this context, a module that is not on Python's path is imported from the working directory.

    The directory comes last on the path, and only while the plug-in is imported or runs. No other module is imported
    from there, not even one that no package provides.
    """
    here = str(Path.cwd())
    top = module.partition(".")[0]
    if here in sys.path or (top not in sys.modules and find_spec(top) is not None) or _is_elsewhere(top, here):
        yield
        return
    sys.path.append(here)
    try:
        yield
    finally:
        sys.path.remove(here)


def _is_elsewhere(top: str, here: str) -> bool:
    """Whether that module has been imported, and from another place than that folder."""
    found = sys.modules.get(top)
    places = [getattr(found, "__file__", None), *getattr(found, "__path__", ())]
    return found is not None and not any(place and Path(place).is_relative_to(here) for place in places)


def _guarded(name: str, planner: Planner, request: PlanningRequest) -> PlannedRound:
    """The planner's answer; raises NoRoute as the planner does, and InvalidInput for any other exception."""
    try:
        with _working_directory_for(name.partition(":")[0]):
            return planner(request)
    except NoRoute:
        raise
    except (Exception, SystemExit) as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        raise InvalidInput(
            f"planner {name}: expected a PlannedRound or NoRoute, got {error_text(error)} "
            f"({Path(where.filename).name}, line {where.lineno})"
        ) from error
