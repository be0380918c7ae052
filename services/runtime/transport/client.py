"""An operator's session: queries that wait for their reply, and subscriptions to checked messages.

It declares nothing that a service waits for, so it cannot delay a mission.
"""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from he3.errors import He3Error, InvalidInput, NotAllowed, OutcomeUnknown, PeerUnreachable
from schemas.codec import Refused, body_of, decode, decode_reply, encode
from schemas.commands import Telecommand
from schemas.link import ClockMode
from schemas.refusal import Refusal
from schemas.roles import Role
from schemas.signing import Part
from schemas.topics import ALIVE, DISPLAYS, EARTH_CLOCK, GROUND_STATUS, LINK_STATUS, Query, Side, Topic
from schemas.wire import Header, Wire
from services.mission.mission_time import seconds
from services.runtime.clock import mission_time
from services.runtime.node import NoReply
from services.runtime.refusals import error_of
from services.runtime.transport.opening import WhileWaiting, open_client
from services.runtime.transport.session import Counts, NotReplied, Outcome, Replied, Session
from services.runtime.trust.certificates import utc_now
from services.runtime.trust.signing import REQUEST_VALID_NS, Signer, Verifier

if TYPE_CHECKING:
    from services.runtime.trust.identity import Identity

QUERY_TIMEOUT_S = 30.0
"""Longest wait for a reply. Queries to an ended process end at once; only a slow or hanging one is waited for."""


CONSENT_VALID_S = 3600.0
"""Mission time for which a signed command without an expiry counts: later it is taken for a replayed one."""
CONSENT_VALID_WALL_S = 300.0
"""But at least this wall time, on the wall clock; in lockstep, where a day may pass in a second, `REQUEST_VALID_NS`."""


class Client:
    """An operator's session on one side. Use it in a `with` statement; its methods may be called from any thread."""

    def __init__(
        self,
        endpoint: str,
        mission: str,
        name: str = "operator",
        side: Side = Side.EARTH,
        while_waiting: WhileWaiting = lambda _: None,
        identity: Identity | None = None,
    ) -> None:
        """Raises PeerUnreachable when no router listens at the endpoint.

        name: source of its messages, unless there is an identity: then its common name is. while_waiting: see
        `open_client`.
        """
        self._mission = mission
        self._name = name if identity is None else identity.common_name
        self._identity = identity
        self._side = side
        self._session = Session(open_client(side, endpoint, while_waiting, identity), mission)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        self._session.close()

    # --- queries ------------------------------------------------------------------------------------------------

    def query(self, topic: Topic, request: Wire, timeout_s: float = QUERY_TIMEOUT_S) -> Any:
        """The body of the reply to a query that carries a message.

        Raises PeerUnreachable when there is no reply, He3Error for one of another version or form, else the exception
        of the refusal's code.
        """
        header = Header(mission=self._mission, source=self._name, incarnation=0, sequence=0, made_at=0)
        if self._identity is None or not topic.signed:
            message = encode(header, request)
        else:
            self._require_right(topic, topic.access_on(self._side).query)
            message = self._signed(topic, header, request, self._identity)
        return self._replied(topic, message, Part.REPLY, timeout_s)[1]

    def _replied(self, topic: Topic, message: bytes, part: Part, timeout_s: float) -> tuple[Header, Any]:
        """Header and body of the first reply that counts. part: REPLY, or MESSAGE for the last message of a topic."""
        signed = self._identity is not None and topic.signed
        counts = partial(self._counts, topic, part) if signed else None
        payload, _ = self._reply(topic, message, timeout_s, counts=counts)
        try:
            return self._read(topic, part, payload)
        except Refused as refusal:
            raise He3Error(str(refusal)) from None

    def _counts(self, topic: Topic, part: Part, payload: bytes) -> bool:
        try:
            self._read(topic, part, payload)
        except Refused:
            return False
        return True

    def _read(self, topic: Topic, part: Part, payload: bytes) -> tuple[Header, Any]:
        """Header and body of a reply; raises Refused for one that does not count."""
        header, body = (decode_reply if part is Part.REPLY else decode)(topic, payload, self._mission)
        if self._identity is not None and topic.signed:
            roles = topic.access.answer if part is Part.REPLY else topic.access.publish
            verifier = self._verifier(self._identity, header.instance)
            verifier.verify(part, topic.name, header, body_of(payload), roles, header.made_at)
        return header, body

    def _signed(self, topic: Topic, header: Header, request: Wire, identity: Identity) -> bytes:
        """The request, signed for the present run of the mission, with the consent to it if it is a command."""
        status, (now, valid_ns) = self._status_of_server(topic), self._now()
        instance = str(status.instance)
        signer = Signer(identity.common_name, identity.key, instance)
        if isinstance(request, Telecommand):
            expires_at = now + valid_ns if request.expires_at is None else max(now, request.expires_at)
            request = signer.authorized(request, self._mission, now, expires_at)
        header = header.model_copy(
            update={
                "sequence": secrets.randbits(48),
                "made_at": now,
                "expires_at": now + REQUEST_VALID_NS,
                "start": status.start,
            }
        )
        return encode(header, request, partial(signer.signed, Part.QUERY, topic.name))

    def _status_of_server(self, topic: Topic) -> Header:
        """Header of the signed status of the process that answers that topic: it names its run and its start."""
        return self.latest(LINK_STATUS if Role.LINK in topic.access.answer else GROUND_STATUS)[0]

    def _verifier(self, identity: Identity, instance: str | None) -> Verifier:
        return Verifier(lambda: identity.roster, self._mission, str(instance), utc_now)

    def _now(self) -> tuple[int, int]:
        """Mission time, and for how long a command without an expiry counts [ns]."""
        header, clock = self.latest(EARTH_CLOCK)
        if clock.mode is ClockMode.LOCKSTEP:
            return header.made_at, REQUEST_VALID_NS
        valid_s = max(CONSENT_VALID_S, CONSENT_VALID_WALL_S * clock.rate)
        return mission_time(clock, time.time_ns()), seconds(valid_s)

    def fetch(
        self, topic: Topic, parameters: Mapping[str, object], timeout_s: float = QUERY_TIMEOUT_S
    ) -> tuple[bytes, bytes]:
        """The raw reply and its attachment to a query by selector parameters, as a stock Zenoh client sends it.

        Raises PeerUnreachable when there is no reply, InvalidInput for parameters that no selector can hold, else the
        exception of the refusal's code.
        """
        return self._reply(topic, None, timeout_s, selector_text(parameters))

    def latest(self, topic: Topic, timeout_s: float = QUERY_TIMEOUT_S) -> tuple[Header, Any]:
        """Header and body of the last message of a topic whose sender keeps it, such as the clock.

        Raises PeerUnreachable when there is no reply, He3Error for one of another version or form, or not signed.
        """
        return self._replied(topic, b"", Part.MESSAGE, timeout_s)

    def _require_right(self, topic: Topic, roles: tuple[Role, ...]) -> None:
        """Raise NotAllowed if the router would drop this without an answer."""
        if self._identity is not None and self._identity.role not in roles:
            expected = " or ".join(roles) or "none"
            raise NotAllowed(
                f"{topic.name}: expected an identity of role {expected}, got {self._identity.common_name} "
                "(--identity DIR or HE3_IDENTITY)"
            )

    def _reply(
        self,
        topic: Topic,
        payload: bytes | None,
        timeout_s: float,
        parameters: str = "",
        counts: Counts | None = None,
    ) -> tuple[bytes, bytes]:
        self._require_right(topic, topic.access_on(self._side).query)
        ended = threading.Event()
        outcomes: list[Outcome] = []

        def on_end(outcome: Outcome) -> None:
            outcomes.append(outcome)
            ended.set()

        self._session.query(topic, payload, timeout_s, on_end, parameters=parameters, counts=counts)
        if not ended.wait(timeout_s + 1.0):
            raise self._unanswered(topic, NoReply.TIMEOUT, f"within {timeout_s:g} s")
        match outcomes[0]:
            case Replied(reply, attachment):
                return reply, attachment
            case NotReplied(NoReply.REFUSED, why, code):
                raise error_of(Refusal(why, code))
            case NotReplied(reason, detail):
                raise self._unanswered(topic, reason, detail)

    def _unanswered(self, topic: Topic, reason: NoReply, detail: str) -> PeerUnreachable:
        """The error that names the process which should have answered, and its mission.

        It names the process, not the topic: an operator can check a process. A process that was reached and has not
        answered may have done what was asked, or may still do it.
        """
        service = " or ".join(topic.access.answer or topic.access.publish)
        if reason is NoReply.NO_ROUTE:
            return PeerUnreachable(f"mission '{self._mission}': the {service} does not answer")
        silence = f"mission '{self._mission}': the {service} has not answered {detail}"
        if isinstance(topic.service, Query) and not topic.service.observes:
            return OutcomeUnknown(f"{silence}, and may have done what was asked")
        return PeerUnreachable(silence)

    # --- subscriptions ------------------------------------------------------------------------------------------

    def subscribe(self, topic: Topic, on_message: Callable[[Header, Any], None]) -> Callable[[], None]:
        """Call `on_message(header, body)`, in another thread, with each well-formed message from now on.

        Returns the function that ends the subscription.
        """

        def checked(payload: bytes, _attachment: bytes) -> None:
            try:
                header, body = decode(topic, payload, self._mission)
            except ValueError:
                return  # malformed: the services count and report those
            on_message(header, body)

        return self._session.subscribe(topic, checked)

    def subscribe_raw(self, topic: Topic, on_payload: Callable[[bytes], None]) -> Callable[[], None]:
        """Call `on_payload`, in another thread, with the bytes of each message from now on.

        Returns the function that ends the subscription.
        """
        return self._session.subscribe(topic, lambda payload, _attachment: on_payload(payload))

    def watch_alive(self, side: Side, on_change: Callable[[str, bool], None], group: str = ALIVE) -> None:
        """Call `on_change(name, alive)`, in another thread, for each process that is alive, appears, or disappears."""
        self._session.watch_alive(side, on_change, group)

    def declare_display(self) -> Callable[[], None]:
        """Say that a display follows the mission to its end; returns the function that takes it back."""
        name = f"{self._name}.{secrets.token_hex(4)}"
        return self._session.declare_alive(name, self._side, DISPLAYS)


def selector_text(parameters: Mapping[str, object]) -> str:
    """The parameters as text for a selector, without those that are None.

    Raises InvalidInput for a value with a character that would end it.
    """
    text = {key: str(value) for key, value in parameters.items() if value is not None}
    for key, value in text.items():
        if not value.isprintable() or any(mark in value for mark in ";#?="):
            raise InvalidInput(f"{key}: expected a value without ';', '#', '?' or '=', got {value[:60]!r}")
    return ";".join(f"{key}={value}" for key, value in text.items())
