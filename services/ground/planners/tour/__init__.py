"""The planner `tour`: one design for all samples that are left, one tour through it, its first piece as the round."""
