"""Rehearsals: the rest of a live mission, flown ahead in virtual time on draws from the posterior.

A rehearsal begins from the copy that the ground gives (`MissionFork`), with the services' own nodes in one process. The
live mission is asked once and not touched. Of the console, only the command line and the page import this room.
"""
