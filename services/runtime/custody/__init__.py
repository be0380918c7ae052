"""Custody: a sender keeps each message until its receiver has acknowledged it.

`protocol` has the rules and settings, `sender` and `receiver` the two halves, `endpoint` both together for one node.
Nothing here does I/O. Only `services.runtime.host` and the drivers import from here.
"""
