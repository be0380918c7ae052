"""Recording of everything that reached Earth."""
