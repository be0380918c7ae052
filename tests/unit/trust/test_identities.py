"""Identities of a mission: issued, read, renewed, revoked; refused when something is wrong with them."""

from __future__ import annotations

import json
from datetime import timedelta

import pytest

from he3.errors import InvalidInput, NotFound
from services.runtime.trust.authority import Authority
from services.runtime.trust.certificates import parse_common_name, subject, utc_now
from services.runtime.trust.identity import load_identity
from services.runtime.trust.roster import read_roster

ANNA = subject("operator", "anna")


@pytest.fixture
def authority(tmp_path):
    return Authority.create(tmp_path / "keys")


def test_an_issued_identity_has_a_key_that_the_roster_verifies(authority):
    identity = load_identity(authority.issue(ANNA))
    assert (identity.role, identity.name, identity.common_name) == ("operator", "anna", "operator.anna")
    entry = identity.roster.trusted("operator.anna", utc_now())
    entry.public_key.verify(identity.key.sign(b"pause"), b"pause")


def test_every_file_is_its_owners_alone(authority):
    authority.issue(ANNA)
    paths = [authority.folder, *authority.folder.rglob("*")]
    assert {path.stat().st_mode & 0o777 for path in paths if path.is_dir()} == {0o700}
    assert {path.stat().st_mode & 0o777 for path in paths if path.is_file()} == {0o600}
    assert any(path.name == "key.pem" for path in paths)


def test_a_key_that_others_may_read_is_refused(authority):
    folder = authority.issue(ANNA)
    (folder / "key.pem").chmod(0o640)
    with pytest.raises(InvalidInput, match=r"key.pem: expected mode 0600, got 0640"):
        load_identity(folder)


def test_a_key_that_is_a_symbolic_link_is_refused(authority, tmp_path):
    folder = authority.issue(ANNA)
    (folder / "key.pem").rename(tmp_path / "elsewhere.pem")
    (folder / "key.pem").symlink_to(tmp_path / "elsewhere.pem")
    with pytest.raises(InvalidInput, match=r"key.pem: cannot read"):
        load_identity(folder)


def test_a_folder_that_others_may_enter_is_refused(authority):
    folder = authority.issue(ANNA)
    folder.chmod(0o755)
    with pytest.raises(InvalidInput, match="expected mode 0700, got 0755"):
        load_identity(folder)


def test_the_key_of_another_identity_is_refused(authority):
    anna, rolf = authority.issue(ANNA), authority.issue(subject("viewer", "rolf"))
    (anna / "key.pem").write_bytes((rolf / "key.pem").read_bytes())
    with pytest.raises(InvalidInput, match=r"key.pem: expected the key of certificate.pem, got another"):
        load_identity(anna)


def test_a_certificate_of_another_authority_is_refused(authority, tmp_path):
    anna = authority.issue(ANNA)
    foreign = Authority.create(tmp_path / "other").issue(ANNA)
    for name in ("certificate.pem", "key.pem"):
        (anna / name).write_bytes((foreign / name).read_bytes())
    with pytest.raises(InvalidInput, match="one of another authority"):
        load_identity(anna)


def test_an_expired_identity_is_refused_until_it_is_renewed(authority):
    folder = authority.issue(ANNA, timedelta(days=1))
    later = utc_now() + timedelta(days=2)
    with pytest.raises(InvalidInput, match=r"operator.anna: the certificate expired at "):
        load_identity(folder, later)
    before = load_identity(folder)
    renewed = load_identity(authority.renew(ANNA, timedelta(days=30)), later)
    assert renewed.common_name == before.common_name
    assert renewed.key.private_bytes_raw() == before.key.private_bytes_raw()


def test_a_revoked_identity_is_refused_everywhere_and_its_name_is_issued_anew_under_another_common_name(authority):
    anna, rover = authority.issue(ANNA), authority.issue(subject("rover", "main"))
    authority.revoke(ANNA)
    with pytest.raises(InvalidInput, match=r"operator.anna was revoked at"):
        load_identity(anna)
    with pytest.raises(InvalidInput, match=r"operator.anna: revoked at"):
        load_identity(rover).roster.trusted("operator.anna", utc_now())
    again = load_identity(authority.issue(ANNA))
    assert again.common_name == "operator.anna.2"
    assert again.roster.allowed(again.role) == ("operator.anna.2",)


def test_what_is_not_there_is_neither_renewed_nor_revoked_and_what_is_there_is_not_issued_twice(authority):
    for change in (authority.renew, authority.revoke):
        with pytest.raises(NotFound, match=r"operator.anna: expected an identity that was issued"):
            change(ANNA)
    authority.issue(ANNA)
    with pytest.raises(InvalidInput, match="expected a new name, got one in use"):
        authority.issue(ANNA)


def test_a_roster_that_was_altered_is_refused(authority):
    identity = load_identity(authority.issue(ANNA))
    authority.revoke(ANNA)
    document = json.loads(identity.roster_path.read_bytes())
    document["roster"]["entries"][0]["revoked_at"] = None
    identity.roster_path.write_text(json.dumps(document))
    with pytest.raises(InvalidInput, match="expected a roster signed by this mission's authority"):
        read_roster(identity.roster_path, identity.authority)


def test_an_authority_is_not_made_twice_in_a_folder(authority):
    with pytest.raises(InvalidInput, match="expected a new folder, got one that has an authority"):
        Authority.create(authority.folder)


@pytest.mark.parametrize("name", ["", "Anna", "a.b", "../x", "a" * 33, "a\n", "-a"])
def test_a_name_that_could_be_mistaken_is_refused(name):
    with pytest.raises(InvalidInput, match="name: expected at most 32 of"):
        subject("operator", name)


@pytest.mark.parametrize(
    "common_name", ["anna", "pilot.anna", "operator.anna.1", "operator.anna.02", "operator.anna.2.3"]
)
def test_a_common_name_of_another_form_is_refused(common_name):
    with pytest.raises(InvalidInput, match=r"expected ROLE.NAME"):
        parse_common_name(common_name)


def test_no_secret_is_in_the_text_of_an_identity_or_an_error(authority):
    folder = authority.issue(ANNA)
    secret = (folder / "key.pem").read_text().splitlines()[1]
    assert secret not in repr(load_identity(folder))
    (folder / "key.pem").write_text(secret)
    with pytest.raises(InvalidInput, match="expected a private key") as error:
        load_identity(folder)
    assert secret not in str(error.value)
