"""Virtual time across processes: a process acts when the time manager grants it a step, and only then.

`participant` and `time_manager` are the two cores without I/O, `pace` limits the speed of virtual time. `driver` runs a
participant over Zenoh; the link's driver (`services.link.lockstep_driver`) runs the time manager.
"""
