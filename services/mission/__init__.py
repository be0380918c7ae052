"""The parts of a mission: its scenario, its region, the link presets, the deployment files, the process table.

Every service and the console import from here. This package imports `he3`, `schemas` and `services.runtime.node` only;
`in_process`, which builds all nodes of a mission for one process, is the one exception.
"""
