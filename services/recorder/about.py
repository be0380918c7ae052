"""What a recording says of its mission, beside the messages: the scenario, and where the region's data come from."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from services.mission.region_folder import provenance_of

if TYPE_CHECKING:
    from services.mission.scenario import Scenario

REGION_RECORD: Final = "region"
"""Metadata record: layer of the region -> where it comes from, in one line."""
SCENARIO_RECORD: Final = "scenario"
"""Metadata record: the whole scenario, as JSON."""


def about(scenario: Scenario) -> dict[str, dict[str, str]]:
    """The metadata records of that scenario's recording, by name."""
    records = {SCENARIO_RECORD: {"json": scenario.model_dump_json()}}
    if region := provenance_of(scenario.region):
        records[REGION_RECORD] = region
    return records
