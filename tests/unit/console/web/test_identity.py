"""The page lets people in by the newest roster of its identity's folder."""

from pathlib import Path

import pytest

from he3.errors import InvalidInput
from schemas.roles import Role
from services.console.web.identity import certified_by
from services.runtime.trust.authority import Authority
from services.runtime.trust.certificates import subject
from services.runtime.trust.identity import load_identity


def test_a_person_who_was_revoked_stays_out_when_an_older_roster_comes_back(tmp_path: Path) -> None:
    authority = Authority.create(tmp_path / "keys")
    for name in ("web", "anna"):
        authority.issue(subject("operator", name))
    server = load_identity(authority.folder_of(subject("operator", "web")))
    certified = certified_by(server)
    assert certified("operator.anna").roles == {Role.OPERATOR}
    before = server.roster_path.read_bytes()
    authority.revoke(subject("operator", "anna"))
    with pytest.raises(InvalidInput, match="revoked"):
        certified("operator.anna")
    server.roster_path.write_bytes(before)
    with pytest.raises(InvalidInput, match="revoked"):
        certified("operator.anna")
    assert certified("operator.web").roles == {Role.OPERATOR}, "the others still get in"
