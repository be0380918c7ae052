"""The rover: executes plans and telecommands on the Moon, and reports samples, events and its state.

`node` routes events to `executive`, which decides what happens next; `states` is the table of its states. The executive
acts through `driving`, `sampling` and `command_handlers`, which do not import it. Other services import nothing from
here: they exchange messages. Imports `services.runtime`, `services.mission`, `schemas` and `he3`.
"""
