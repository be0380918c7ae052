"""The page's server: static files, the mission as server-sent events, the map as arrays, commands where allowed."""

from __future__ import annotations

import asyncio
import io
import re
import threading
import zipfile
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import (
    FileResponse,
    JSONResponse,
    PlainTextResponse,
    RedirectResponse,
    Response,
    StreamingResponse,
)
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp

from he3.colour_maps import OF_LAYER, stops
from he3.errors import He3Error, InvalidInput, PeerUnreachable
from schemas.mission_log import AlarmAction
from schemas.plans import PlanVerdict
from schemas.roles import Role
from schemas.topics import MAP_BOX, MAP_HISTORY, MAP_LAYER, MAP_POINT, MAP_RESOURCE, TRACK, Topic
from services.console.client.areas import AreaKind
from services.console.client.link import link_change
from services.console.client.map_files import CUTOFF_PPB
from services.console.rehearsal.alternative import alternatives_of
from services.console.web.access import ACT, COMMAND, CONTROL, READ, Access, Caller
from services.console.web.connections import PEER
from services.console.web.guard import Guard
from services.console.web.hub import Hub, Viewer, command_document
from services.console.web.requests import (
    AlarmRequest,
    CommandRequest,
    InterestRequest,
    PlanRequest,
    PlayRequest,
    RehearsalRequest,
    RehearsalStop,
    StackAnswer,
    StackRequest,
    StackStop,
    document,
    parsed,
)
from services.mission.mission_time import seconds

STATIC = Path(__file__).parent / "static"
KEEP_ALIVE_S = 15.0
MAX_AT_WORK = 64
"""Requests that may wait for the mission at a time; further ones are refused at once."""
FRESH = {"cache-control": "no-store"}
LOG_IN = "expected a login: open the address with a token that he3 web has printed, or present a certificate"
AUTHORITY = "he3 web --authority prints an address that may command"
RECORDED = "this is a recording, which cannot be commanded"
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

Endpoint = Callable[[Request], Awaitable[Response]]

_PARAMETER = re.compile(r"[a-z_]{1,40}")


def page(hub: Hub, hosts: Sequence[str], access: Access, warning: str | None = None) -> ASGIApp:
    """The application; hosts: names (without port) that it may be reached by. warning: shown on every page."""
    answers = _Answers(access, AUTHORITY if hub.recording is None else RECORDED)

    def get(path: str, answer: Answer) -> Route:
        return Route(path, answers.of(answer, READ), methods=["GET"])

    def post(path: str, answer: Answer, roles: frozenset[Role]) -> Route:
        return Route(path, answers.of(answer, roles), methods=["POST"])

    posted: dict[str, tuple[Callable[[Hub, Asked], Response], frozenset[Role]]] = {
        "preview": (_preview, READ),
        "command": (_command, COMMAND),
        "plan": (_decide, COMMAND),
        "stack/check": (_check_stack, READ),
        "stack": (_send_stack, COMMAND),
        "stack/answer": (_answer_stack, COMMAND),
        "stack/stop": (_stop_stack, COMMAND),
        "interest": (_interest, COMMAND),
        "link": (_link, CONTROL),
        "alarm": (_alarm, ACT),
        "recording": (_play, READ),
        "rehearsal": (_rehearse, READ),
        "rehearsal/stop": (_stop_rehearsal, READ),
    }
    routes = [
        Route("/", answers.document(STATIC / "index.html")),
        Route("/login", partial(_login, access)),
        Route("/api/logout", partial(_logout, access), methods=["POST"]),
        Route("/api/stream", answers.stream(hub)),
        get("/api/session", partial(_session, hub, warning)),
        get("/api/colours", _colours),
        get("/api/interest", partial(_interests, hub)),
        get("/api/map/export", partial(_export, hub, threading.Lock())),
        *(get(f"/api/map/{name}", partial(_ask, hub, topic)) for name, topic in ASKED.items()),
        get("/api/plan", partial(_plan, hub)),
        get("/api/rehearsal", partial(_rehearsal, hub)),
        *(post(f"/api/{name}", partial(answer, hub), roles) for name, (answer, roles) in posted.items()),
        # Browsers ask for it by this name where they show a file instead of the page.
        Route("/favicon.ico", lambda _: FileResponse(STATIC / "icon.svg")),
        Mount("/static", StaticFiles(directory=STATIC)),
    ]
    return Starlette(
        routes=routes, middleware=[Middleware(Guard, hosts=hosts)], exception_handlers={HTTPException: _http_error}
    )


@dataclass(frozen=True, slots=True)
class Asked:
    """A request whose caller has the right to make it."""

    caller: Caller
    parameters: Mapping[str, str]
    body: bytes


Answer = Callable[[Asked], Response]


class _Answers:
    """Makes endpoints that know their caller, and that limit the number of requests at a time."""

    def __init__(self, access: Access, hint: str) -> None:
        """hint: what a caller is told who lacks a right."""
        self._access = access
        self._hint = hint
        self._at_work = 0

    def of(self, answer: Answer, roles: frozenset[Role]) -> Endpoint:
        """The answer for callers of one of these roles; errors as one line of JSON.

        It is made in a thread, because the event loop must not wait for the mission.
        """

        async def endpoint(request: Request) -> Response:
            caller = self._admitted(request, roles)
            if isinstance(caller, Response):
                return caller
            if self._at_work >= MAX_AT_WORK:
                return _error(f"expected at most {MAX_AT_WORK} requests at a time, got more: try again", 503)
            self._at_work += 1
            try:
                return await _answered(answer, caller, request)
            finally:
                self._at_work -= 1

        return endpoint

    def document(self, path: Path) -> Endpoint:
        """A file for callers who may read."""

        async def endpoint(request: Request) -> Response:
            refusal = self._admitted(request, READ)
            if isinstance(refusal, Response):
                return PlainTextResponse(LOG_IN, status_code=refusal.status_code, headers=FRESH)
            return FileResponse(path, headers=FRESH)

        return endpoint

    def stream(self, hub: Hub) -> Endpoint:
        """The mission's stream for callers who may read, for as long as they may."""

        async def endpoint(request: Request) -> Response:
            refusal = self._admitted(request, READ)
            if isinstance(refusal, Response):
                return refusal
            return await _stream(hub, lambda: not isinstance(self._admitted(request, READ), Response))

        return endpoint

    def _admitted(self, request: Request, roles: frozenset[Role]) -> Caller | Response:
        """The caller if it has one of these roles; else the refusal."""
        try:
            caller = self._access.caller(request.headers.get("cookie", ""), request.scope.get(PEER))
        except InvalidInput as refusal:
            return _error(str(refusal), 403)
        if caller is None:
            return _error(LOG_IN, 401)
        if not caller.roles & roles:
            wanted, came = " or ".join(sorted(roles)), ", ".join(sorted(caller.roles))
            return _error(f"expected {wanted}, got {came}: {self._hint}", 403)
        return caller


async def _answered(answer: Answer, caller: Caller, request: Request) -> Response:
    try:
        async with asyncio.timeout(BODY_WITHIN_S):
            body = await request.body() if request.method == "POST" else b""
    except TimeoutError:
        return _error(f"expected the whole request within {BODY_WITHIN_S:g} s, got a part of it", 408)
    except ClientDisconnect:
        return _error("the client went away", 400)
    try:
        return await asyncio.to_thread(answer, Asked(caller, dict(request.query_params), body))
    except PeerUnreachable as error:
        return _error(str(error), 503)
    except He3Error as error:
        return _error(str(error), 400)


async def _login(access: Access, request: Request) -> Response:
    """Begin a session with the token of the address, and redirect to the page without it."""
    session = access.log_in(request.query_params.get("token", ""))
    if session is None:
        return PlainTextResponse(LOG_IN, status_code=403, headers=FRESH)
    return RedirectResponse("/", status_code=303, headers={**FRESH, "set-cookie": session})


async def _logout(access: Access, request: Request) -> Response:
    """End the session of this browser; its stream ends with the next message."""
    session = access.log_out(request.headers.get("cookie", ""))
    return JSONResponse({"ended": True}, headers={**FRESH, "set-cookie": session})


async def _http_error(_: Request, error: Exception) -> Response:
    """The reply to an unknown path or method."""
    assert isinstance(error, HTTPException), "registered for that class alone"
    return _error(str(error.detail), error.status_code)


def _error(why: str, code: int) -> Response:
    return JSONResponse({"error": why}, status_code=code)


def _ask(hub: Hub, topic: Topic, asked: Asked) -> Response:
    parameters = dict(asked.parameters)
    for name in parameters:
        if not _PARAMETER.fullmatch(name):
            raise InvalidInput(f"expected parameters such as x and as_of, got {name[:40]!r}")
    payload, about = hub.last_map.answer(topic, parameters)
    binary = bool(about) and parameters.get("format", "json") != "json"
    headers = dict(FRESH)
    if about:
        headers["x-map-about"] = about.decode()
    media_type = "application/octet-stream" if binary else "application/json"
    return Response(payload, media_type=media_type, headers=headers)


def _export(hub: Hub, at_work: threading.Lock, asked: Asked) -> Response:
    """The whole map as a zip file; one at a time, because it takes seconds."""
    wanted = asked.parameters
    if not wanted.keys() <= {"as_of", "threshold"}:
        raise InvalidInput("map export: expected as_of and threshold; got another parameter")
    try:
        threshold = float(wanted.get("threshold", CUTOFF_PPB))
    except ValueError:
        raise InvalidInput(f"map export: expected a threshold [ppb], got {wanted['threshold'][:40]!r}") from None
    if not at_work.acquire(blocking=False):
        return _error("an export is being made: try again when it is done", 503)
    try:
        with TemporaryDirectory(prefix="he3-maps-") as scratch:
            folder = Path(scratch) / "maps"
            done = hub.mission.export_maps(folder, threshold_ppb=threshold, as_of=wanted.get("as_of"))
            content = io.BytesIO()
            with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
                for name in done.files:
                    archive.write(folder / name, name)
    finally:
        at_work.release()
    file = f"{hub.mission.mission}-maps-{done.revision}.zip"
    headers = {**FRESH, "content-disposition": f'attachment; filename="{file}"'}
    return Response(content.getvalue(), media_type="application/zip", headers=headers)


def _taken(hub: Hub, wanted: CommandRequest) -> Response | None:
    """The refusal of a keep-out under a name that is in use, unless it is to replace that one."""
    if wanted.polygon_m is None or wanted.replace:
        return None
    objection = hub.mission.name_objection(AreaKind.KEEP_OUT, wanted.area_id)
    return None if objection is None else _error(objection, 409)


def _preview(hub: Hub, asked: Asked) -> Response:
    wanted = parsed(CommandRequest, asked.body)
    if (refusal := _taken(hub, wanted)) is not None:
        return refusal
    outlook = hub.mission.preview(
        wanted.kind, target_m=wanted.target_m, area_id=wanted.area_id, polygon_m=wanted.polygon_m
    )
    return JSONResponse(outlook.document(), headers=FRESH)


def _command(hub: Hub, asked: Asked) -> Response:
    wanted = parsed(CommandRequest, asked.body)
    if (refusal := _taken(hub, wanted)) is not None:
        return refusal
    issued = hub.mission.command(
        wanted.kind,
        target_m=wanted.target_m,
        area_id=wanted.area_id,
        polygon_m=wanted.polygon_m,
        expires_in_s=wanted.expires_in_s,
    )
    return JSONResponse(command_document(issued.status))


def _plan(hub: Hub, _: Asked) -> Response:
    proposal = hub.mission.proposed_plan()
    return JSONResponse({"proposal": None if proposal is None else proposal.model_dump(mode="json")}, headers=FRESH)


def _decide(hub: Hub, asked: Asked) -> Response:
    wanted = parsed(PlanRequest, asked.body)
    if wanted.verdict is PlanVerdict.APPROVE:
        hub.mission.approve_plan(wanted.proposal, wanted.drop)
    elif wanted.verdict is PlanVerdict.REVISE:
        hub.mission.revise_plan(wanted.proposal, wanted.places_m)
    else:
        hub.mission.send_plan_back(wanted.proposal)
    return _plan(hub, asked)


def _check_stack(hub: Hub, asked: Asked) -> Response:
    return JSONResponse(hub.stacks.check(parsed(StackRequest, asked.body).text), headers=FRESH)


def _send_stack(hub: Hub, asked: Asked) -> Response:
    wanted = parsed(StackRequest, asked.body)
    hub.stacks.start(wanted.text, wanted.step, asked.caller.name)
    return _stack(hub)


def _answer_stack(hub: Hub, asked: Asked) -> Response:
    wanted = parsed(StackAnswer, asked.body)
    hub.stacks.answer(wanted.number, wanted.line, wanted.send)
    return _stack(hub)


def _stop_stack(hub: Hub, asked: Asked) -> Response:
    hub.stacks.stop(parsed(StackStop, asked.body).number, asked.caller.name)
    return _stack(hub)


def _stack(hub: Hub) -> Response:
    return JSONResponse({"stack": hub.stacks.document()}, headers=FRESH)


def _link(hub: Hub, asked: Asked) -> Response:
    wanted = document(asked.body)
    if not wanted.keys() <= LINK_FIELDS:
        raise InvalidInput(f"link: expected some of {', '.join(sorted(LINK_FIELDS))}; got another")
    return JSONResponse(hub.mission.change_link(link_change(wanted)).model_dump(mode="json"))


def _interest(hub: Hub, asked: Asked) -> Response:
    wanted = parsed(InterestRequest, asked.body)
    if wanted.polygon_m is not None and not wanted.replace:
        objection = hub.mission.name_objection(AreaKind.INTEREST, wanted.area_id)
        if objection is not None:
            return _error(objection, 409)
    return _areas(hub.mission.set_interest(wanted.area_id, wanted.polygon_m, wanted.weight))


def _interests(hub: Hub, _: Asked) -> Response:
    return _areas(hub.mission.set_interest())


def _areas(areas: Sequence[Any]) -> Response:
    return JSONResponse({"areas": [area.model_dump(mode="json") for area in areas]})


def _alarm(hub: Hub, asked: Asked) -> Response:
    """Whether the mark was made: not on an alarm that is no longer there."""
    wanted = parsed(AlarmRequest, asked.body)
    raised = hub.is_raised(wanted.kind)
    if raised:
        if wanted.shelve_s is not None:
            hub.mission.shelve_alarm(wanted.kind, hub.mission.now() + seconds(wanted.shelve_s), wanted.why)
        elif wanted.action is AlarmAction.ACKNOWLEDGE:
            hub.mission.acknowledge_alarm(wanted.kind, wanted.why)
        else:
            hub.mission.unshelve_alarm(wanted.kind, wanted.why)
    return JSONResponse({"done": raised})


def _play(hub: Hub, asked: Asked) -> Response:
    wanted = parsed(PlayRequest, asked.body)
    return JSONResponse(hub.play(wanted.at_s, wanted.pace), headers=FRESH)


def _rehearsal(hub: Hub, asked: Asked) -> Response:
    known = asked.parameters.get("known", "0")
    if not known.isdecimal() or len(known) > 15:
        raise InvalidInput(f"rehearsal: expected the number of one in known, got {known[:40]!r}")
    return _told_rehearsal(hub, asked.caller, int(known))


def _rehearse(hub: Hub, asked: Asked) -> Response:
    wanted = parsed(RehearsalRequest, asked.body)
    hub.rehearsals.begin(wanted.draws, alternatives_of(wanted.against), asked.caller.name)
    return _told_rehearsal(hub, asked.caller)


def _stop_rehearsal(hub: Hub, asked: Asked) -> Response:
    number = parsed(RehearsalStop, asked.body).number
    hub.rehearsals.stop(number, asked.caller.name, of_any=bool(asked.caller.roles & ACT))
    return _told_rehearsal(hub, asked.caller)


def _told_rehearsal(hub: Hub, caller: Caller, known: int | None = None) -> Response:
    document = hub.rehearsals.document(known, by=caller.name, of_any=bool(caller.roles & ACT))
    return JSONResponse(document, headers=FRESH)


def _session(hub: Hub, warning: str | None, asked: Asked) -> Response:
    return JSONResponse({**asked.caller.document(), "warning": warning or hub.warning}, headers=FRESH)


def _colours(_: Asked) -> Response:
    return JSONResponse({"of_layer": dict(OF_LAYER), "stops": {name: stops(name) for name in set(OF_LAYER.values())}})


async def _stream(hub: Hub, admitted: Callable[[], bool]) -> Response:
    """The stream; it ends before the first message after its caller has lost the right to read."""
    viewer = Viewer(asyncio.get_running_loop())
    if not hub.enter(viewer):
        return _error("expected fewer browsers, got one too many: close some", 503)

    async def messages() -> AsyncIterator[str]:
        try:
            yield "retry: 1000\n\n"
            while True:
                try:
                    text = await asyncio.wait_for(viewer.queue.get(), KEEP_ALIVE_S)
                except TimeoutError:
                    text = ": keep-alive\n\n"
                if text is None or not admitted():
                    return
                yield text
        finally:
            hub.leave(viewer)

    return StreamingResponse(messages(), media_type="text/event-stream", headers=FRESH)
