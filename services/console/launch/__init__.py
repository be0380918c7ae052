"""Starts a mission: its services as separate processes, or all of its nodes in this process."""
