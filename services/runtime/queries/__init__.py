"""How operators' queries are answered from snapshots.

A service's process owns a query process (`process`) and gives it each snapshot through a pipe (`pipe`). The query
process (`pipe_server`) answers in threads (`server`), so the node never waits for an operator.
"""
