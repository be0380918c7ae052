"""The field: the Moon itself, which answers the rover's instruments with measurements and true terrain.

`node` answers queries from the reference region; `hazards` places boulders that the orbital map does not show. Other
services import nothing from here. Imports `services.runtime`, `services.mission`, `schemas` and `he3`.
"""
