"""Telecommands that a Python program issues."""

import pytest

from he3.errors import InvalidInput
from services.console.client.commands import Commanding


class Unasked(Commanding):
    """A client that never reads the time and sends nothing."""

    def __init__(self) -> None:
        pass


@pytest.mark.parametrize("value", [[1], "1", (1,), True, 0, -1, float("nan"), float("inf"), 10**30])
def test_a_validity_that_is_no_number_of_seconds_is_refused_before_anything_is_computed_with_it(value: object) -> None:
    with pytest.raises(InvalidInput, match="expires_in_s: expected seconds over 0"):
        Unasked().command("pause", expires_in_s=value)  # type: ignore[arg-type]
