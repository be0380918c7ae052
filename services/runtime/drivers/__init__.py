"""The drivers that run nodes on the wall clock and in the simulation; `services.runtime.lockstep` is the third one."""
