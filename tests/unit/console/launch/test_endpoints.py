"""Where a mission's routers listen: where every client looks for them, unless another program listens there."""

from __future__ import annotations

import re
import socket

import pytest

from he3.errors import He3Error
from services.console.launch.endpoints import Endpoints, endpoints_near, free_endpoints, require_free


def test_endpoints_that_are_free_are_those_of_the_scenario_and_a_second_mission_gets_others():
    wanted = free_endpoints()
    with endpoints_near(wanted) as first, endpoints_near(wanted) as second:
        assert first == wanted
        assert {second.moon, second.earth}.isdisjoint({wanted.moon, wanted.earth})
    with endpoints_near(wanted) as third:
        assert third == wanted


def test_an_endpoint_where_another_program_listens_is_left_to_it():
    wanted = free_endpoints()
    with socket.socket() as stranger:
        stranger.bind(("127.0.0.1", int(wanted.earth.rsplit(":", 1)[1])))
        stranger.listen()
        with endpoints_near(wanted) as near:
            assert near != wanted


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "0.0.0.0"])
def test_an_address_in_use_is_said_before_anything_is_started(host):
    wanted = free_endpoints()
    port = int(wanted.earth.rsplit(":", 1)[1])
    taken = Endpoints(wanted.moon, f"tcp/{host}:{port}")
    require_free(taken)
    with socket.create_server(("127.0.0.1", port)):
        expected = f"cannot listen as the earth router at tcp/{host}:{port}: the address is in use by another program"
        with pytest.raises(He3Error, match=re.escape(expected)):
            require_free(taken)
    require_free(taken)


@pytest.mark.parametrize(
    "endpoint", ["tcp/192.0.2.1:7448", "tcp/127.0.0.1:99999", "unixsock-stream/x", "tcp/no such:1"]
)
def test_an_endpoint_that_cannot_be_checked_here_is_left_to_the_link(endpoint):
    require_free(Endpoints(free_endpoints().moon, endpoint))


def test_a_scenario_of_two_machines_runs_on_loopback_when_all_of_it_runs_here():
    with endpoints_near(Endpoints("tcp/192.0.2.1:7447", "tcp/192.0.2.2:7448")) as near:
        assert near.moon.startswith("tcp/127.0.0.1:")
