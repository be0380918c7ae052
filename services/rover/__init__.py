"""The rover: executes plans, drives, drills, analyses; safe when out of contact."""
