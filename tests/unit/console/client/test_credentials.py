"""As whom a command joins a mission: the identity that is named, the environment's, or the launcher's viewer."""

from __future__ import annotations

import os

import pytest

from he3.errors import InvalidInput
from schemas.roles import Role
from services.console.client.credentials import IDENTITY, credentials_for
from services.console.client.run_file import RunningMission, announced
from services.runtime.trust.authority import Authority
from services.runtime.trust.certificates import Subject

TLS, PLAIN, FAR = "tls/127.0.0.1:2", "tcp/127.0.0.1:2", "tcp/10.0.0.2:2"


@pytest.fixture(scope="module")
def authority(tmp_path_factory):
    return Authority.create(tmp_path_factory.mktemp("credentials") / "keys")


@pytest.fixture(scope="module")
def viewer(authority):
    return authority.issue(Subject(Role.VIEWER, "launcher"))


@pytest.fixture(scope="module")
def anna(authority):
    return authority.issue(Subject(Role.OPERATOR, "anna"))


@pytest.fixture(autouse=True)
def _own_run_files(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.delenv(IDENTITY, raising=False)


def running(earth=TLS, viewer="", moon="tls/127.0.0.1:1", insecure=False):
    return announced(RunningMission("m", "m.toml", moon, earth, os.getpid(), {}, str(viewer), insecure))


def name_of(credentials):
    return None if credentials.identity is None else credentials.identity.common_name


def test_the_named_identity_counts_before_the_environments_and_that_before_the_launchers(viewer, anna, monkeypatch):
    with running(viewer=viewer):
        assert name_of(credentials_for(TLS, "m")) == "viewer.launcher"
        monkeypatch.setenv(IDENTITY, str(anna))
        assert name_of(credentials_for(TLS, "m")) == "operator.anna"
        assert name_of(credentials_for(TLS, "m", viewer)) == "viewer.launcher"


def test_on_loopback_without_tls_the_environments_identity_is_not_needed(anna, monkeypatch):
    monkeypatch.setenv(IDENTITY, str(anna))
    assert credentials_for(PLAIN, "m") == credentials_for(PLAIN, "other")
    assert name_of(credentials_for(PLAIN, "m")) is None
    with pytest.raises(InvalidInput, match="expected a tls/ endpoint with --identity"):
        credentials_for(PLAIN, "m", anna)


def test_tls_without_any_identity_is_refused():
    with pytest.raises(InvalidInput, match="expected an identity for TLS: give --identity DIR"):
        credentials_for(TLS, "m")


def test_an_endpoint_off_loopback_without_tls_is_refused_unless_the_user_insists_or_runs_it():
    with pytest.raises(InvalidInput, match="expected TLS off loopback"):
        credentials_for(FAR, "m")
    assert "INSECURE" in (credentials_for(FAR, "m", insecure=True).warning or "")
    with running(earth=FAR, insecure=True):
        assert "INSECURE" in (credentials_for(FAR, "m").warning or "")


def test_an_insecure_moon_router_is_warned_of_although_the_earth_router_is_local():
    with running(earth=PLAIN, moon="tcp/0.0.0.0:1", insecure=True):
        assert "tcp/0.0.0.0:1" in (credentials_for(PLAIN, "m").warning or "")
