"""``he3`` alone: the missions that run on this machine, and what to do next."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from services.console.client.run_file import RunningMission

WITHOUT_MISSION = """No mission runs on this machine. What to do next:

  he3 demo                       a whole mission in a minute or two, with a report and a map
  he3 up t1 --rate 100           start a mission and keep it running; then, in another terminal:
  he3 web --authority            the operator's page in a browser
  he3 watch                      the mission in the terminal

A mission of another machine is joined with --earth and --mission: he3 status --earth tcp/10.0.0.2:7448 --mission t1
A recording is summarised with he3 replay FILE
"""

WITH_MISSION = (
    ("he3 status", "where the rover is, what is on the way"),
    ("he3 web --authority", "the operator's page in a browser"),
    ("he3 watch", "the mission in the terminal"),
    ("he3 alarms", "what needs attention"),
    ("he3 map at 120 340", "how much helium-3 is there, and how certain is that?"),
    ("he3 command --help", "telecommands to the rover"),
)

MORE = """
All commands: he3 --help      Tab completion: he3 --install-completion, then a new terminal
"""


def next_steps(running: Sequence[RunningMission]) -> str:
    """What an operator may do next, for these missions on their machine."""
    if not running:
        return WITHOUT_MISSION + MORE
    listed = [f"Mission '{each.mission}' runs at {each.earth}." for each in running]
    flags = f" --mission {running[0].mission}" if len(running) > 1 else ""
    rows = [(words if "--help" in words else words + flags, about) for words, about in WITH_MISSION]
    width = max(len(words) for words, _ in rows)
    steps = [f"  {words:<{width}}   {about}" for words, about in rows]
    return "\n".join([*listed, "What to do next:", "", *steps, MORE])
