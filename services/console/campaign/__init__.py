"""Campaigns: thousands of independent tasks, most of them missions, on an engine, into a store that outlives it.

`study` makes tasks of a TOML file, `engines` computes them, `store` keeps a row for each, `runner` joins the three, and
`figures` and `page` say what the rows teach. A task names a function and its arguments in JSON; `worker` is the process
that calls it, the same on every engine, so that a result does not depend on where it was computed. The benchmarks run
their own functions with `runner`.
"""
