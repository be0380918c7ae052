"""One process holds each role: the first that claims it, until it is gone or silent and another one asks."""

from __future__ import annotations

import pytest

from he3.errors import InvalidInput
from schemas.claims import RoleClaim, RoleHolder
from schemas.topics import Side
from services.link.role_holders import MAX_TOKENS, SILENT_S, RoleHolders

FIRST, SECOND = "rover.1.aa.moonbase", "rover.2.bb.moonbase"


@pytest.fixture
def holders() -> RoleHolders:
    """Both processes have a token."""
    holders = RoleHolders()
    for process in (FIRST, SECOND):
        holders.seen(Side.MOON, process, True)
    return holders


def claim(holders: RoleHolders, process: str, now_s: float, name: str = "rover") -> RoleHolder:
    return holders.claim(Side.MOON, RoleClaim(name=name, process=process), now_s)


def test_of_two_that_start_at_once_the_first_to_claim_has_the_role(holders: RoleHolders) -> None:
    assert claim(holders, SECOND, 0.0).process == SECOND
    assert claim(holders, FIRST, 0.0).process == SECOND


def test_a_second_process_sees_by_the_renewals_that_the_first_one_works(holders: RoleHolders) -> None:
    claim(holders, FIRST, 0.0)
    before = claim(holders, SECOND, 0.1).renewals
    assert claim(holders, SECOND, 0.5).renewals == before
    claim(holders, FIRST, 1.0)
    assert claim(holders, SECOND, 1.1).renewals > before


def test_after_a_kill_the_role_is_free_at_once(holders: RoleHolders) -> None:
    claim(holders, FIRST, 0.0)
    holders.seen(Side.MOON, FIRST, False)
    assert claim(holders, SECOND, 0.01).process == SECOND
    holders.seen(Side.MOON, FIRST, True)
    assert claim(holders, FIRST, 0.02).process == SECOND, "who comes back finds that it has lost the role"


def test_a_process_that_hangs_keeps_its_role_until_another_one_asks_for_it(holders: RoleHolders) -> None:
    claim(holders, FIRST, 0.0)
    assert claim(holders, SECOND, SILENT_S).process == FIRST
    assert claim(holders, FIRST, 100.0).process == FIRST, "nobody asked meanwhile"
    assert claim(holders, SECOND, 101.0 + SILENT_S).process == SECOND
    assert claim(holders, FIRST, 102.0 + SILENT_S).process == SECOND


def test_roles_are_held_apart(holders: RoleHolders) -> None:
    claim(holders, FIRST, 0.0)
    holders.seen(Side.MOON, "field.3.cc.moonbase", True)
    assert claim(holders, "field.3.cc.moonbase", 0.0, "field").process == "field.3.cc.moonbase"


def test_a_claim_without_a_token_or_under_another_name_counts_nothing(holders: RoleHolders) -> None:
    assert claim(holders, "rover.9.zz.elsewhere", 0.0) == RoleHolder(process=None, renewals=0)
    with pytest.raises(InvalidInput, match=r"expected the name of a field process, got 'rover\.1\.aa\.moonbase'"):
        claim(holders, FIRST, 0.0, "field")
    assert claim(holders, FIRST, 0.0).process == FIRST


def test_a_flood_of_tokens_is_bounded() -> None:
    holders = RoleHolders()
    for number in range(2 * MAX_TOKENS):
        holders.seen(Side.EARTH, f"ground.{number}.a.b", True)
    assert len(holders._alive) == MAX_TOKENS
