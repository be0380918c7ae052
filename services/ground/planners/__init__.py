"""The planners: one signature for all, arrays and frozen values in, a planned round out."""
