"""The Moon itself: serves reference measurements and true terrain to the rover's instruments."""
