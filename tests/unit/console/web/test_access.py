"""Logins of the page: tokens, sessions, certificates, and what a role allows."""

from __future__ import annotations

import pytest

from he3.errors import InvalidInput
from schemas.roles import Role
from services.console.web.access import (
    COMMAND,
    CONTROL,
    MAX_SESSIONS,
    READ,
    SESSION_S,
    Access,
    Caller,
    common_name_of_peer,
)

ANNA = Caller("operator.anna", frozenset({Role.OPERATOR}))
VIEWER = frozenset({Role.VIEWER})


def cookie(header: str | None) -> str:
    assert header is not None
    return header.partition(";")[0]


def test_a_token_begins_a_session_and_the_session_names_its_caller() -> None:
    access = Access(8030)
    session = access.log_in(access.new_token(ANNA))
    assert access.caller(cookie(session), None) == ANNA


def test_a_stranger_is_none_or_whom_the_server_lets_in_without_a_login() -> None:
    for given in ("", "he3-8030=guess", "he3-8030=", "\x00", "a" * 100_000, "he3-8030=a; he3-8030=b", "=;=;"):
        assert Access(8030).caller(given, None) is None
        assert Access(8030, anonymous=VIEWER).caller(given, None) == Caller("local", VIEWER)


@pytest.mark.parametrize("token", ["", "guess", "a" * 100_000, "\udcff", "é"])
def test_a_token_that_was_not_given_out_begins_nothing(token: str) -> None:
    access = Access(8030)
    access.new_token(ANNA)
    assert access.log_in(token) is None


def test_a_session_ends_and_there_are_no_more_than_so_many() -> None:
    now = 0.0
    access = Access(8030, now=lambda: now)
    token = access.new_token(ANNA)
    first = cookie(access.log_in(token))
    for _ in range(MAX_SESSIONS):
        last = cookie(access.log_in(token))
    assert access.caller(first, None) is None
    assert access.caller(last, None) == ANNA
    now = SESSION_S + 1
    assert access.caller(last, None) is None


def test_a_person_ends_their_own_session_and_no_other() -> None:
    access = Access(8030, anonymous=VIEWER)
    token = access.new_token(ANNA)
    mine, other = cookie(access.log_in(token)), cookie(access.log_in(token))
    found = access.caller(mine, None)
    assert found is not None
    assert found.document()["logged_in"] is True
    header = access.log_out(mine)
    assert header.startswith("he3-8030=; HttpOnly; SameSite=Strict; Path=/; Max-Age=0")
    after = access.caller(mine, None)
    assert after == Caller("local", VIEWER)
    assert after.document()["logged_in"] is False
    assert access.caller(other, None) == ANNA
    for given in ("", mine, "he3-8030=guess", "\x00"):
        access.log_out(given)
    assert access.caller(other, None) == ANNA


def test_who_may_only_read_ends_no_session_of_who_may_command() -> None:
    access = Access(8030)
    commander = cookie(access.log_in(access.new_token(ANNA)))
    reader = access.new_token(Caller("page.reader", VIEWER))
    for _ in range(2 * MAX_SESSIONS):
        access.log_in(reader)
    assert access.caller(commander, None) == ANNA
    assert len(access._sessions) == MAX_SESSIONS + 1


def test_a_cookie_is_kept_from_scripts_and_other_sites_and_under_tls_from_plain_connections() -> None:
    plain, secure = (Access(8030, secure=each) for each in (False, True))
    over_http, over_tls = (each.log_in(each.new_token(ANNA)) or "" for each in (plain, secure))
    assert all("; HttpOnly; SameSite=Strict; Path=/" in each for each in (over_http, over_tls))
    assert over_tls.startswith("__Host-he3-8030=")
    assert over_tls.endswith("; Secure")
    assert "Secure" not in over_http


def test_neither_tokens_nor_sessions_are_kept_as_they_are() -> None:
    access = Access(8030)
    token = access.new_token(ANNA)
    session = cookie(access.log_in(token)).partition("=")[2]
    kept = repr(vars(access))
    assert token not in kept
    assert session not in kept


def test_a_certificate_counts_before_a_session_and_is_refused_where_none_are_known() -> None:
    certified = {"operator.anna": ANNA}
    access = Access(8030, anonymous=VIEWER, certified=certified.__getitem__)
    assert access.caller("", "operator.anna") == ANNA
    with pytest.raises(InvalidInput, match="expected a login"):
        Access(8030, anonymous=VIEWER).caller("", "operator.anna")


def test_no_caller_may_do_more_than_the_server_itself() -> None:
    access = Access(8030, certified=lambda _: ANNA, able=frozenset({Role.VIEWER, Role.CONTROLLER}))
    assert access.caller("", "operator.anna") == Caller("operator.anna", VIEWER)


def test_the_common_name_of_a_certificate_is_unique_or_none() -> None:
    subject = ((("commonName", "operator.anna"),),)
    assert common_name_of_peer({"subject": subject}) == "operator.anna"
    assert common_name_of_peer({"subject": subject + subject}) == ""
    assert common_name_of_peer({"subject": ()}) == ""
    assert common_name_of_peer({}) is None
    assert common_name_of_peer(None) is None


def test_viewers_read_operators_command_and_controllers_change_the_link() -> None:
    assert {Role.VIEWER, Role.OPERATOR, Role.CONTROLLER} == READ
    assert {Role.OPERATOR} == COMMAND
    assert {Role.CONTROLLER} == CONTROL
