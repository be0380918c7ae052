"""Zenoh, and nothing else: the only package that opens sessions. All others see bytes, topics and sides."""
