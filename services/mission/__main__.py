"""Prints the table of processes as it stands in docs/architecture.md: ``python -m services.mission``."""

import sys

from services.mission.processes import process_table

if __name__ == "__main__":
    sys.stdout.write(process_table())
