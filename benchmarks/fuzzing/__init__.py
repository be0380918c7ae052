"""Fuzzing of everything that takes input from outside: command line, files, messages, page requests.

Each module is one *surface*: it makes random examples, feeds them to the real code, and returns the faults found.
`benchmarks.fuzz` runs all surfaces; the test suite runs a part of it.
"""
