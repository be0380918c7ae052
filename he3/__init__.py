"""The science, pure: arrays in, arrays out. Only numpy and scipy, no I/O."""
