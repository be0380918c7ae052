"""The page's server: static files, the mission as server-sent events, the map as arrays, commands where allowed."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator, Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp

from he3.colour_maps import OF_LAYER, stops
from he3.errors import He3Error, InvalidInput, PeerUnreachable
from schemas.topics import MAP_BOX, MAP_HISTORY, MAP_LAYER, MAP_POINT, MAP_RESOURCE, TRACK, Topic
from services.console.client.link import link_change
from services.console.web.guard import Guard
from services.console.web.hub import Hub, Viewer
from services.console.web.requests import AcknowledgeRequest, CommandRequest, InterestRequest, document, parsed

STATIC = Path(__file__).parent / "static"
KEEP_ALIVE_S = 15.0
BODY_WITHIN_S = 10.0
"""Longest time for a request's body to arrive."""

ASKED = {
    "point": MAP_POINT,
    "layer": MAP_LAYER,
    "box": MAP_BOX,
    "resource": MAP_RESOURCE,
    "track": TRACK,
    "history": MAP_HISTORY,
}
"""Queries of the map that the page passes on as they are."""

LINK_FIELDS = frozenset(
    {"direction", "one_way_light_time_s", "loss", "rate_bit_s", "unlimited_rate", "jitter_s", "contact"}
    | {"contact_as_scheduled"}
)
"""Fields of the link's conditions that the page may change."""

_PARAMETER = re.compile(r"[a-z_]{1,40}")


def page(hub: Hub, hosts: Sequence[str]) -> ASGIApp:
    """The application; hosts: names (without port) that it may be reached by."""
    routes = [
        Route("/", lambda _: FileResponse(STATIC / "index.html")),
        Route("/api/stream", partial(_stream, hub)),
        Route("/api/colours", _colours),
        Route("/api/interest", _answered(partial(_interests, hub)), methods=["GET"]),
        *(Route(f"/api/map/{name}", _answered(partial(_ask, hub, topic))) for name, topic in ASKED.items()),
        Route("/api/command", _answered(partial(_command, hub)), methods=["POST"]),
        Route("/api/link", _answered(partial(_link, hub)), methods=["POST"]),
        Route("/api/interest", _answered(partial(_interest, hub)), methods=["POST"]),
        Route("/api/acknowledge", _answered(partial(_acknowledge, hub)), methods=["POST"]),
        Mount("/static", StaticFiles(directory=STATIC)),
    ]
    return Starlette(
        routes=routes, middleware=[Middleware(Guard, hosts=hosts)], exception_handlers={HTTPException: _http_error}
    )


def _answered(answer: Callable[[Request, bytes], Response]) -> Callable[[Request], Any]:
    """The answer, made in a thread because the event loop must not wait for the mission; errors as one line of JSON."""

    async def answered(request: Request) -> Response:
        try:
            async with asyncio.timeout(BODY_WITHIN_S):
                body = await request.body() if request.method == "POST" else b""
        except TimeoutError:
            return _error(f"expected the whole request within {BODY_WITHIN_S:g} s, got a part of it", 408)
        except ClientDisconnect:
            return _error("the client went away", 400)
        try:
            return await asyncio.to_thread(answer, request, body)
        except PeerUnreachable as error:
            return _error(str(error), 503)
        except He3Error as error:
            return _error(str(error), 400)

    return answered


async def _http_error(_: Request, error: Exception) -> Response:
    """The reply to an unknown path or method."""
    assert isinstance(error, HTTPException), "registered for that class alone"
    return _error(str(error.detail), error.status_code)


def _error(why: str, code: int) -> Response:
    return JSONResponse({"error": why}, status_code=code)


def _ask(hub: Hub, topic: Topic, request: Request, _: bytes) -> Response:
    parameters = dict(request.query_params)
    for name in parameters:
        if not _PARAMETER.fullmatch(name):
            raise InvalidInput(f"expected parameters such as x and as_of, got {name[:40]!r}")
    payload, about = hub.mission.passed_on(topic, parameters)
    binary = bool(about) and parameters.get("format", "json") != "json"
    headers = {"cache-control": "no-store"}
    if about:
        headers["x-map-about"] = about.decode()
    media_type = "application/octet-stream" if binary else "application/json"
    return Response(payload, media_type=media_type, headers=headers)


def _command(hub: Hub, _: Request, body: bytes) -> Response:
    _must_have_authority(hub)
    wanted = parsed(CommandRequest, body)
    issued = hub.mission.command(
        wanted.kind,
        target_m=wanted.target_m,
        area_id=wanted.area_id,
        polygon_m=wanted.polygon_m,
        expires_in_s=wanted.expires_in_s,
    )
    return JSONResponse(issued.status.model_dump(mode="json"))


def _link(hub: Hub, _: Request, body: bytes) -> Response:
    _must_have_authority(hub)
    wanted = document(body)
    if not wanted.keys() <= LINK_FIELDS:
        raise InvalidInput(f"link: expected some of {', '.join(sorted(LINK_FIELDS))}; got another")
    return JSONResponse(hub.mission.change_link(link_change(wanted)).model_dump(mode="json"))


def _interest(hub: Hub, _: Request, body: bytes) -> Response:
    _must_have_authority(hub)
    wanted = parsed(InterestRequest, body)
    return _areas(hub.mission.set_interest(wanted.area_id, wanted.polygon_m, wanted.weight))


def _interests(hub: Hub, _: Request, __: bytes) -> Response:
    return _areas(hub.mission.set_interest())


def _areas(areas: Sequence[Any]) -> Response:
    return JSONResponse({"areas": [area.model_dump(mode="json") for area in areas]})


def _acknowledge(hub: Hub, _: Request, body: bytes) -> Response:
    return JSONResponse({"acknowledged": hub.acknowledge(parsed(AcknowledgeRequest, body).id)})


def _must_have_authority(hub: Hub) -> None:
    if not hub.authority:
        raise InvalidInput("this page is read-only: start it with he3 web --authority to command")


async def _colours(_: Request) -> Response:
    return JSONResponse({"of_layer": dict(OF_LAYER), "stops": {name: stops(name) for name in set(OF_LAYER.values())}})


async def _stream(hub: Hub, _: Request) -> Response:
    viewer = Viewer(asyncio.get_running_loop())
    hub.enter(viewer)

    async def messages() -> AsyncIterator[str]:
        try:
            yield "retry: 1000\n\n"
            while True:
                try:
                    text = await asyncio.wait_for(viewer.queue.get(), KEEP_ALIVE_S)
                except TimeoutError:
                    yield ": keep-alive\n\n"
                    continue
                if text is None:
                    return
                yield text
        finally:
            hub.leave(viewer)

    return StreamingResponse(messages(), media_type="text/event-stream", headers={"cache-control": "no-store"})
