"""Where a mission's routers listen: where every client looks for them, unless somebody is there already."""

from __future__ import annotations

import socket

from services.console.launch.launcher import Endpoints, endpoints_near, free_endpoints


def test_endpoints_that_are_free_are_those_of_the_scenario_and_a_second_mission_gets_others():
    wanted = free_endpoints()
    with endpoints_near(wanted) as first, endpoints_near(wanted) as second:
        assert first == wanted
        assert {second.moon, second.earth}.isdisjoint({wanted.moon, wanted.earth})
    with endpoints_near(wanted) as third:
        assert third == wanted


def test_an_endpoint_that_somebody_listens_on_is_left_to_them():
    wanted = free_endpoints()
    with socket.socket() as stranger:
        stranger.bind(("127.0.0.1", int(wanted.earth.rsplit(":", 1)[1])))
        stranger.listen()
        with endpoints_near(wanted) as near:
            assert near != wanted


def test_a_scenario_of_two_machines_runs_on_loopback_when_all_of_it_runs_here():
    with endpoints_near(Endpoints("tcp/192.0.2.1:7447", "tcp/192.0.2.2:7448")) as near:
        assert near.moon.startswith("tcp/127.0.0.1:")
