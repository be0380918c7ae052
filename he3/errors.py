"""The exceptions of the whole system: one root, which each process catches once, at its edge."""


class He3Error(Exception):
    """Root of all errors that are reported in one line; the text has the form "expected ..., got ..."."""


class InvalidInput(He3Error, ValueError):
    """An input (a file, a flag, a value, an array) is not as required; nothing was changed."""


class NumericalFailure(He3Error, ArithmeticError):
    """A computation failed that should have succeeded; the text has the numbers that show why."""


class OutsideRegion(InvalidInput):
    """A place lies outside the region."""


class NoRoute(He3Error):
    """No traversable path leads from one place to another within the given limits."""


class PeerUnreachable(He3Error):
    """A peer process is not running, or did not reply in time."""


class OutcomeUnknown(PeerUnreachable):
    """A peer was reached and did not reply in time: it may have done what was asked, or may still do it."""


class NotFound(He3Error):
    """The request is well formed, but what it names does not exist."""


class NotReady(He3Error):
    """What was requested does not exist yet; the same request may succeed later."""


class NotAllowed(He3Error):
    """The identity of the process or person does not have the right that this takes."""


class Busy(He3Error):
    """Too much work is waiting; the same request may succeed later."""
