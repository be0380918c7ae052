"""Command authority: one holder at a time, taken explicitly and taken over by name."""

from __future__ import annotations

import pytest

from he3.errors import InvalidInput
from schemas.authority import AuthorityAction, AuthorityChange, AuthorityState
from schemas.commands import Authorization, CommandKind, Telecommand
from services.ground.authority import CommandAuthority


def command(by, kind=CommandKind.PAUSE):
    """With a name that has a role, one that is proven."""
    plain = Telecommand(command_id="c-1", kind=kind)
    if "." not in by:
        return plain.model_copy(update={"issued_by": by or None})
    consent = Authorization(signer=by, instance="run-1", made_at=0, expires_at=9, signature="0" * 128)
    return plain.model_copy(update={"authorization": consent})


def take(by, over_from=None):
    return AuthorityChange(action=AuthorityAction.TAKE, by=by, over_from=over_from)


def release(by):
    return AuthorityChange(action=AuthorityAction.RELEASE, by=by)


def may(authority, by, kind=CommandKind.PAUSE):
    return authority.objection(command(by, kind)) is None


def test_without_keys_whoever_commands_holds_it_and_keeps_nobody_out():
    authority = CommandAuthority()
    for name in ("anna@earth", "ben@earth", ""):
        assert may(authority, name)
        authority.commanded(command(name), 5)
    assert authority.state == AuthorityState(holder="ben@earth", since=5)


def test_with_keys_the_first_who_commands_holds_it_and_keeps_others_out():
    authority = CommandAuthority()
    authority.commanded(command("operator.anna"), 5)
    assert may(authority, "operator.anna")
    assert authority.objection(command("operator.ben")) == (
        "command c-1 of operator.ben: expected the holder of command authority, operator.anna "
        "(he3 authority take --force operator.anna)"
    )
    authority.commanded(command("operator.ben", CommandKind.SAFE), 6)
    assert authority.state.holder == "operator.anna"


@pytest.mark.parametrize(("holder", "other"), [("anna@earth", "ben@earth"), ("operator.anna", "operator.ben")])
def test_who_has_taken_it_keeps_others_out_until_it_is_released(holder, other):
    authority = CommandAuthority()
    assert authority.change(take(holder), 5) == AuthorityState(holder=holder, since=5, explicit=True)
    assert authority.change(take(holder), 7).since == 5, "once more changes nothing"
    assert not may(authority, other)
    assert not may(authority, "")
    with pytest.raises(InvalidInput, match=f"expected its holder, {holder}, to release it, got {other}"):
        authority.change(release(other), 8)
    assert authority.change(release(holder), 9) == AuthorityState()
    assert may(authority, other)


def test_safe_is_everybodys():
    authority = CommandAuthority()
    authority.change(take("operator.anna"), 5)
    assert may(authority, "operator.ben", CommandKind.SAFE)


def test_it_is_taken_over_by_naming_the_present_holder():
    authority = CommandAuthority()
    authority.change(take("operator.anna"), 5)
    with pytest.raises(InvalidInput, match=r"held by operator.anna: to take it over, he3 authority take --force"):
        authority.change(take("operator.ben"), 6)
    with pytest.raises(InvalidInput, match=r"expected the name of its present holder, operator.anna, got operator.eve"):
        authority.change(take("operator.ben", "operator.eve"), 6)
    assert authority.change(take("operator.ben", "operator.anna"), 7).holder == "operator.ben"
    assert not may(authority, "operator.anna")


def test_two_who_take_it_over_from_the_same_holder_do_not_both_get_it():
    authority = CommandAuthority()
    authority.change(take("operator.anna"), 5)
    authority.change(take("operator.ben", "operator.anna"), 6)
    with pytest.raises(InvalidInput, match=r"present holder, operator.ben"):
        authority.change(take("operator.eve", "operator.anna"), 7)


def test_it_survives_a_restart():
    authority, again = CommandAuthority(), CommandAuthority()
    authority.commanded(command("operator.anna"), 5)
    again.restore(authority.checkpoint())
    assert not may(again, "operator.ben")
