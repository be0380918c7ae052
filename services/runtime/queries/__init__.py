"""Operator queries: read from selectors or messages, and answered from snapshots in threads or in a process apart."""
