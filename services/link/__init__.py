"""The link: the only path between Earth and Moon, with light time, data rate, impairments and contact.

`node` is its state machine: `relay` holds one `channel` a direction. `clock_keeper` keeps mission time on the wall
clock, `lockstep_driver` virtual time. Other services import nothing from here. Imports `services.runtime`,
`services.mission`, `schemas` and `he3`.
"""
