"""What a planner foresees of the goal is said in words that an operator can act on."""

from __future__ import annotations

import numpy as np

from services.ground.planners.foresight import forecast_of


def test_a_forecast_says_what_it_takes_and_what_is_missing() -> None:
    assert forecast_of(12, 340.0, 0.4, 0.5, 20, np.inf).reachable
    metres = forecast_of(12, 340.0, 0.4, 0.5, 20, 300.0)
    assert not metres.reachable
    assert metres.text == "it takes about 12 more samples and 340 m, of 300 m left"
    samples = forecast_of(20, 500.0, 0.62, 0.5, 20, np.inf)
    assert not samples.reachable
    assert samples.samples is None
    assert samples.text == "with the 20 samples left the greatest std is about 0.620 ppb; the goal takes 0.500"
