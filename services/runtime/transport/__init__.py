"""Zenoh, and nothing else: the only package that opens sessions. All other code sees bytes, topics and sides.

`session` is a service's session on one side; `client` is an operator's. `request` reads a query, `inputs` makes a
node's input of it. It imports `schemas` and
`services.mission.deployment`, where the shipped Zenoh configurations lie.
"""
