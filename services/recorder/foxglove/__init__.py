"""The mission in Foxglove's message schemas, which Foxglove and Rerun draw: derived from our own messages.

`derivation` makes them, `scene` and `position` are its parts, `schemas` encodes them with protobuf from the descriptors
in `schemas.binpb`. Nothing of Foxglove's software is needed for that. The recorder writes them beside our messages, and
``he3 foxglove`` streams them. Imports `he3` and our schemas.
"""
