"""A mission's progress on the terminal, and its outputs: the report, pictures, and the map as numbers."""
