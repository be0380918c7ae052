"""The live map as operators see it: snapshots, layers, history, pictures, estimates, the feed, and query replies."""
