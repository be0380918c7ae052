"""The planner `tour`: one design for all remaining samples, one tour through it, and its first piece as the round."""
