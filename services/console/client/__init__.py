"""The one operator client: `MissionClient`, split by concern.

`mission_client` joins a mission and combines `map_queries`, `commands`, `link`, `clock`, `live` and `feed`, each a
class over one Zenoh session. `mission_state` keeps the newest facts of a mission for a display; `alarms`, `contacts`
and `log_lines` say what follows from them. `stacks` sends lists of commands. `run_file` finds the missions that run
on this machine. Command line, page, notebooks and benchmarks reach a mission through this package only. It may import
`schemas` and `services.runtime`, and nothing else of the console.
"""
