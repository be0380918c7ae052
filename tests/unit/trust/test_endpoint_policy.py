"""Which endpoints may be used: TLS with an identity, or loopback; anything else only when the user insists."""

from __future__ import annotations

import pytest

from he3.errors import InvalidInput
from services.runtime.options import parse_options
from services.runtime.trust.endpoint_policy import check_endpoint, is_local, with_tls


@pytest.mark.parametrize(
    ("endpoint", "local"),
    [
        ("tcp/127.0.0.1:7447", True),
        ("tcp/127.9.9.9:1", True),
        ("tcp/localhost:7447", True),
        ("tcp/[::1]:7447", True),
        ("unixsock-stream//run/he3.sock", True),
        ("tcp/0.0.0.0:7447", False),
        ("tcp/[::]:7447", False),
        ("tcp/10.0.0.2:7447", False),
        ("tcp/localhost.example.org:7447", False),
        ("tcp/127.0.0.1.example.org:7447", False),
        ("tcp/earth:7447", False),
        ("tcp/nonsense", False),
    ],
)
def test_an_endpoint_is_local_only_if_no_other_machine_reaches_it(endpoint, local):
    assert is_local(endpoint) == local
    if local:
        assert check_endpoint(endpoint, identified=False) is None
        return
    with pytest.raises(InvalidInput, match=r"expected TLS off loopback: .* or --insecure"):
        check_endpoint(endpoint, identified=False)
    assert "INSECURE" in (check_endpoint(endpoint, identified=False, insecure=True) or "")


def test_an_identity_and_tls_go_together():
    assert check_endpoint("tls/10.0.0.2:7447", identified=True) is None
    with pytest.raises(InvalidInput, match="expected an identity for TLS"):
        check_endpoint("tls/127.0.0.1:7447", identified=False, insecure=True)
    with pytest.raises(InvalidInput, match="expected a tls/ endpoint with --identity"):
        check_endpoint("tcp/127.0.0.1:7447", identified=True, insecure=True)


@pytest.mark.parametrize(
    "options",
    [
        "#enable_mtls=false",
        "#root_ca_certificate_file=/tmp/mine.pem",
        "#root_ca_certificate_base64=LS0tLS1CRUdJTg==",
        "?rel=0",
    ],
)
def test_a_tls_endpoint_brings_no_authority_or_other_options_of_its_own(options):
    for endpoint in (f"tls/127.0.0.1:7448{options}", with_tls(f"tcp/10.0.0.2:7448{options}")):
        with pytest.raises(InvalidInput, match="expected a TLS endpoint as tls/HOST:PORT, got one with options"):
            check_endpoint(endpoint, identified=True, insecure=True)


def test_a_plain_endpoint_becomes_one_with_tls():
    assert with_tls("tcp/127.0.0.1:7447") == "tls/127.0.0.1:7447"
    assert with_tls("tls/earth:1") == "tls/earth:1"
    with pytest.raises(InvalidInput, match="expected a tcp/ or tls/ endpoint with keys"):
        with_tls("unixsock-stream//run/x")


def test_a_service_refuses_an_endpoint_of_its_own_side_only():
    far = ["short", "--moon", "tcp/0.0.0.0:7447"]
    with pytest.raises(InvalidInput, match=r"tcp/0.0.0.0:7447: expected TLS off loopback"):
        parse_options("rover", far)
    assert parse_options("ground", far).insecure == ()
    (warning,) = parse_options("link", [*far, "--insecure"]).insecure
    assert warning.startswith("INSECURE: tcp/0.0.0.0:7447")
