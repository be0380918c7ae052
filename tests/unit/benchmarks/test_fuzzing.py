"""Random input from outside, on every surface: nothing raises, hangs, or is refused in more than one line."""

import pytest

from benchmarks.fuzz import fuzz, surfaces

EXAMPLES = {"cli": 600, "scenario": 350, "region": 1500, "messages": 2000, "page": 500, "page-tls": 50}
"""5,000 in all, of which the gate runs a tenth; `he3 bench fuzz --examples N` runs more, from other seeds."""


@pytest.mark.parametrize("share", [0.1, pytest.param(1.0, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("name", sorted(surfaces()))
def test_random_input_is_taken_or_refused_in_one_line(name: str, share: float) -> None:
    examples = round(share * EXAMPLES[name])
    outcome = fuzz(name, examples, seed=20301)
    assert outcome["examples"] == examples
    assert outcome["faults"] == []


def test_every_surface_is_fuzzed() -> None:
    assert set(EXAMPLES) == set(surfaces())
    assert sum(EXAMPLES.values()) == 5_000
