"""Zenoh's access rules for each router, made from the topic table and the roster: what is not allowed is denied.

A rule is about one role, one right and one direction. A right to publish, for example, covers the peer's messages going
in and the declarations of subscribers coming out. Keys are spelled out, one by one: a pattern such as `tm/**` would not
match the keys of lockstep, which end with `@counted`, and would match keys that are added later.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from schemas.roles import PERSON_ROLES, PROCESS_ROLES, Role
from schemas.topics import (
    ALIVE,
    DISPLAYS,
    HOLDERS,
    MEMBERS,
    ONLOOKERS,
    SIDES,
    TOPICS,
    Access,
    Side,
    Topic,
    addressed,
    counted,
    liveliness_key,
)

if TYPE_CHECKING:
    from services.runtime.trust.roster import Roster


class Right(StrEnum):
    """The rights that a role may have on a key."""

    PUBLISH = "publish"
    SUBSCRIBE = "subscribe"
    QUERY = "query"
    ANSWER = "answer"
    APPEAR = "appear"
    """Declare a liveliness token."""
    WATCH = "watch"
    """Follow liveliness tokens."""


PARTICIPANTS: tuple[Role, ...] = tuple(role for role in PROCESS_ROLES if role is not Role.RECORDER)
"""The roles that take part in lockstep: virtual time waits for them, so messages to them are counted."""

_GOES_IN: dict[Right, tuple[str, ...]] = {
    Right.PUBLISH: ("put",),
    Right.SUBSCRIBE: ("declare_subscriber",),
    Right.QUERY: ("query",),
    Right.ANSWER: ("declare_queryable", "reply"),
    Right.APPEAR: ("liveliness_token",),
    Right.WATCH: ("declare_liveliness_subscriber", "liveliness_query"),
}
"""Zenoh's messages from a peer to the router, by the peer's right."""
_COMES_OUT: dict[Right, tuple[str, ...]] = {
    Right.PUBLISH: ("declare_subscriber",),
    Right.SUBSCRIBE: ("put",),
    Right.QUERY: ("declare_queryable", "reply"),
    Right.ANSWER: ("query",),
    Right.APPEAR: (),
    Right.WATCH: ("liveliness_token",),
}
"""Zenoh's messages from the router to a peer, by the peer's right."""

Keys = dict[Right, tuple[str, ...]]


def allowed_keys(side: Side, mission: str) -> dict[Role, Keys]:
    """The keys of that mission which each role may use on that side, by right; a role without any is not in it."""
    found: dict[Role, dict[Right, list[str]]] = {role: {} for role in Role}

    def allow(right: Right, roles: tuple[Role, ...], *keys: str) -> None:
        for role in roles:
            found[role].setdefault(right, []).extend(keys)

    for topic in TOPICS:
        if side in topic.sides:
            for right, by_role in _topic_keys(topic, topic.access_on(side), mission).items():
                for role, keys in by_role.items():
                    allow(right, (role,), *keys)
    for role in PROCESS_ROLES:
        if side in SIDES[role]:
            allow(Right.APPEAR, (role,), liveliness_key(mission, side, role.value, ALIVE))
            if role is not Role.LINK:
                allow(Right.APPEAR, (role,), liveliness_key(mission, side, f"{role.value}.$*", HOLDERS))
            if role in PARTICIPANTS:  # a name, a process id and a random number
                allow(Right.APPEAR, (role,), liveliness_key(mission, side, f"{role.value}.$*", MEMBERS))
            else:
                allow(Right.APPEAR, (role,), liveliness_key(mission, side, role.value, ONLOOKERS))
    watchers = tuple(role for role in (Role.LINK, *PERSON_ROLES) if side in SIDES[role])
    allow(Right.WATCH, watchers, liveliness_key(mission, side, "*", ALIVE))
    for role in (each for each in PERSON_ROLES if side in SIDES[each]):
        allow(Right.APPEAR, (role,), liveliness_key(mission, side, f"{role.value}.$*", DISPLAYS))
        allow(Right.WATCH, (role,), liveliness_key(mission, side, "*", DISPLAYS))
    for group in (MEMBERS, ONLOOKERS, HOLDERS):
        allow(Right.WATCH, (Role.LINK,), liveliness_key(mission, side, "*", group))
    return {role: {right: tuple(keys) for right, keys in rights.items()} for role, rights in found.items() if rights}


def _topic_keys(topic: Topic, access: Access, mission: str) -> dict[Right, dict[Role, list[str]]]:
    """The keys of one topic on one side, by right and role."""
    key = topic.key(mission)
    if topic.per_process:
        own = {role: [counted(addressed(topic, role.value)).key(mission)] for role in access.subscribe}
        every = [key for keys in own.values() for key in keys]
        return {Right.PUBLISH: dict.fromkeys(access.publish, every), Right.SUBSCRIBE: own}
    publish = {role: [key] for role in access.publish}
    subscribe = {role: [key] for role in access.subscribe}
    waited_for = [role for role in access.subscribe if role in PARTICIPANTS]
    if waited_for:
        twin = counted(topic).key(mission)
        for role in waited_for:
            subscribe[role].append(twin)
        for role in access.publish:
            if role in PARTICIPANTS:
                publish[role].append(twin)
    return {
        Right.PUBLISH: publish,
        Right.SUBSCRIBE: subscribe,
        Right.QUERY: {role: [key] for role in access.query},
        Right.ANSWER: {role: [key] for role in access.answer},
    }


def access_control(side: Side, mission: str, names: Mapping[Role, tuple[str, ...]]) -> dict[str, Any]:
    """Zenoh's `access_control` of that side's router. names: the common names that have each role, see `names_of`."""
    rules: list[dict[str, Any]] = []
    subjects: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []
    for role, rights in allowed_keys(side, mission).items():
        if not names.get(role):
            continue  # Zenoh takes a subject without a name for every peer
        own = []
        for right, keys in rights.items():
            for flow, messages in (("ingress", _GOES_IN[right]), ("egress", _COMES_OUT[right])):
                if messages:
                    own.append(f"{role}-{right}-{flow}")
                    rules.append(
                        {
                            "id": own[-1],
                            "permission": "allow",
                            "flows": [flow],
                            "messages": list(messages),
                            "key_exprs": list(keys),
                        }
                    )
        subjects.append({"id": role.value, "cert_common_names": list(names[role])})
        policies.append({"rules": own, "subjects": [role.value]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def names_of(roster: Roster) -> dict[Role, tuple[str, ...]]:
    """The common names of each role that are not revoked."""
    return {role: roster.allowed(role) for role in Role}
