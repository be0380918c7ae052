"""The page's server: static files, the mission as server-sent events, the map as arrays, commands where allowed."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp

from he3.colour_maps import OF_LAYER, stops
from he3.errors import He3Error, InvalidInput, PeerUnreachable
from schemas.topics import MAP_BOX, MAP_HISTORY, MAP_LAYER, MAP_POINT, MAP_RESOURCE, TRACK, Topic
from services.console.web.guard import Guard
from services.console.web.hub import Hub, Viewer

STATIC = Path(__file__).parent / "static"
KEEP_ALIVE_S = 15.0

ASKED = {
    "point": MAP_POINT,
    "layer": MAP_LAYER,
    "box": MAP_BOX,
    "resource": MAP_RESOURCE,
    "track": TRACK,
    "history": MAP_HISTORY,
}
"""Questions of the map that the page passes on as they are."""


def page(hub: Hub, hosts: Sequence[str]) -> ASGIApp:
    """The application; hosts: names (without port) that it may be reached by."""
    routes = [
        Route("/", lambda _: FileResponse(STATIC / "index.html")),
        Route("/api/stream", partial(_stream, hub)),
        Route("/api/colours", _colours),
        Route("/api/interest", _told(partial(_interests, hub)), methods=["GET"]),
        *(Route(f"/api/map/{name}", _told(partial(_ask, hub, topic))) for name, topic in ASKED.items()),
        Route("/api/command", _told(partial(_command, hub)), methods=["POST"]),
        Route("/api/link", _told(partial(_link, hub)), methods=["POST"]),
        Route("/api/interest", _told(partial(_interest, hub)), methods=["POST"]),
        Route("/api/acknowledge", _told(partial(_acknowledge, hub)), methods=["POST"]),
        Mount("/static", StaticFiles(directory=STATIC)),
    ]
    return Starlette(routes=routes, middleware=[Middleware(Guard, hosts=hosts)])


def _told(answer: Callable[[Request, Any], Response]) -> Callable[[Request], Any]:
    """The answer, made in a thread, as nothing of the mission may be waited for in the loop; errors in one line."""

    async def told(request: Request) -> Response:
        body = await request.body() if request.method == "POST" else b""
        try:
            document = json.loads(body) if body else None
        except ValueError:
            return JSONResponse({"error": "expected JSON, got something else"}, status_code=400)
        try:
            response: Response = await asyncio.to_thread(answer, request, document)
        except PeerUnreachable as error:
            return JSONResponse({"error": str(error)}, status_code=503)
        except He3Error as error:
            return JSONResponse({"error": str(error)}, status_code=400)
        return response

    return told


def _ask(hub: Hub, topic: Topic, request: Request, _: Any) -> Response:
    payload, about = hub.mission.client.fetch(topic, dict(request.query_params), timeout_s=30.0)
    binary = bool(about) and request.query_params.get("format", "json") != "json"
    headers = {"cache-control": "no-store"}
    if about:
        headers["x-map-about"] = about.decode()
    media_type = "application/octet-stream" if binary else "application/json"
    return Response(payload, media_type=media_type, headers=headers)


def _command(hub: Hub, _: Request, document: Any) -> Response:
    _must_have_authority(hub)
    wanted = _fields(document, {"kind", "target_m", "area_id", "polygon_m", "expires_in_s"})
    if not isinstance(wanted.get("kind"), str):
        raise InvalidInput("command: expected a kind, got none")
    for key in ("target_m", "polygon_m"):
        if wanted.get(key) is not None:
            wanted[key] = _places(key, wanted[key])
    issued = hub.mission.command(**wanted)
    return JSONResponse(issued.status.model_dump(mode="json"))


def _link(hub: Hub, _: Request, document: Any) -> Response:
    _must_have_authority(hub)
    allowed = {"direction", "one_way_light_time_s", "loss", "rate_bit_s", "unlimited_rate", "jitter_s", "contact"}
    return JSONResponse(
        hub.mission.set_link_from_json(_fields(document, allowed | {"contact_as_scheduled"})).model_dump(mode="json")
    )


def _interest(hub: Hub, _: Request, document: Any) -> Response:
    _must_have_authority(hub)
    wanted = _fields(document, {"area_id", "polygon_m", "weight"})
    polygon = wanted.get("polygon_m")
    weight = wanted.get("weight", 2.0)
    if not isinstance(weight, int | float):
        raise InvalidInput("interest: expected a number as weight, got something else")
    areas = hub.mission.set_interest(
        wanted.get("area_id"), None if polygon is None else _places("polygon_m", polygon), weight
    )
    return JSONResponse({"areas": [area.model_dump(mode="json") for area in areas]})


def _interests(hub: Hub, _: Request, __: Any) -> Response:
    return JSONResponse({"areas": [area.model_dump(mode="json") for area in hub.mission.set_interest()]})


def _acknowledge(hub: Hub, _: Request, document: Any) -> Response:
    alarm_id = _fields(document, {"id"}).get("id")
    return JSONResponse({"acknowledged": hub.acknowledge(str(alarm_id))})


def _must_have_authority(hub: Hub) -> None:
    if not hub.authority:
        raise InvalidInput("this page only looks on: start it with he3 web --authority to command")


def _fields(document: Any, allowed: set[str]) -> dict[str, Any]:
    if not isinstance(document, dict) or not document.keys() <= allowed:
        raise InvalidInput(f"expected an object with some of {', '.join(sorted(allowed))}")
    return document


def _places(key: str, value: Any) -> Any:
    try:
        if key == "target_m":
            x, y = value
            return float(x), float(y)
        return [(float(x), float(y)) for x, y in value]
    except (TypeError, ValueError):
        raise InvalidInput(f"{key}: expected places as [x, y], got something else") from None


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
                    yield ": here\n\n"
                    continue
                if text is None:
                    return
                yield text
        finally:
            hub.leave(viewer)

    return StreamingResponse(messages(), media_type="text/event-stream", headers={"cache-control": "no-store"})
