"""What every process stands on: the contract of nodes, and what drives a node, keeps it and connects it.

Every service imports from here. This package imports `he3`, `schemas` and `services.mission`, and no service.
"""
