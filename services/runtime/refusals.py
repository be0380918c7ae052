"""Which exception a refusal's code stands for, in both directions: raised by a server, raised again by its client."""

from __future__ import annotations

from he3.errors import Busy, He3Error, InvalidInput, NotFound, NotReady, OutsideRegion
from schemas.codec import Refused
from schemas.refusal import Refusal, RefusalCode

EXCEPTIONS: dict[RefusalCode, type[He3Error]] = {
    RefusalCode.OUTSIDE_REGION: OutsideRegion,
    RefusalCode.INVALID_INPUT: InvalidInput,
    RefusalCode.NOT_FOUND: NotFound,
    RefusalCode.NOT_READY: NotReady,
    RefusalCode.BUSY: Busy,
    RefusalCode.INTERNAL: He3Error,
}
"""A class stands before its parents, so the first match is the most specific."""


def refusal_of(error: Exception) -> Refusal:
    """The refusal that reports that error on the wire; `RefusalCode.INTERNAL` for an error without a code."""
    if isinstance(error, Refused):
        return Refusal(str(error), RefusalCode.INVALID_INPUT)
    code = next((code for code, kind in EXCEPTIONS.items() if isinstance(error, kind)), RefusalCode.INTERNAL)
    return Refusal(str(error), code)


def error_of(refusal: Refusal) -> He3Error:
    """The exception that a client raises for that refusal; its text is the refusal's."""
    return EXCEPTIONS[refusal.code](refusal.error)
