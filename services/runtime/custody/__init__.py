"""Custody: a sender keeps each message until its receiver has acknowledged it.

`protocol` has the settings and the table of states; `sender` stands on `stream` (what is kept), `window` (what is sent
next) and `retransmission` (when it is repeated); `receiver` is the other half, and `endpoint` is both for one node.
Nothing here does I/O. Only `services.runtime.host` and the drivers import from here.
"""
