"""The ground station: holds the belief, plans, directs the rover, serves the live map."""
