"""The common base of all processes.

Without I/O: `node` is the contract of nodes, `host` and `scheduler` stand around one, `custody` keeps what crosses the
link. With I/O: `entry` is what a process does first, `child` how it starts another one of ours. `process` is the shell
of a service's process, and hands its parts (`context`) to a driver (`drivers`, `lockstep`). `transport` is Zenoh,
`queries` answers operators, `journal` keeps inputs.

Every service imports from here. This package imports `he3`, `schemas` and `services.mission`, and no service.
"""
