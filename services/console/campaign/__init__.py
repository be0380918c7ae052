"""Campaigns: thousands of independent tasks, most of them missions, on an engine, into a store that outlives it.

`study` makes tasks of a TOML file, `engines` computes them, `store` keeps a row for each, and `runner` joins the three.
A task names a function and its arguments in JSON; `worker` is the process that calls it, the same on every engine, so
that a result does not depend on where it was computed. `table` makes columns of the rows, `statistics` and `findings`
say what they teach, `summary` and `page` show it. The benchmarks run their own functions with `runner`.
"""
