"""The exception tree of the whole system: one root, so that each process can catch once, at its edge."""


class He3Error(Exception):
    """Something went wrong that one clear line explains; the text says what was expected and what came."""


class InvalidInput(He3Error, ValueError):
    """What was handed in (a file, a flag, a value, an array) is not what was asked for; nothing was changed."""


class NumericalFailure(He3Error, ArithmeticError):
    """A computation that should have succeeded did not, with the numbers that tell why."""


class OutsideRegion(InvalidInput):
    """A place lies outside the site's region."""


class NoRoute(He3Error):
    """No traversable way leads from one place to another within the given limits."""


class PeerUnreachable(He3Error):
    """The other side of a conversation is not there, or did not answer in time."""


class NotFound(He3Error):
    """The request is well formed, but what it names does not exist."""


class NotReady(He3Error):
    """What was requested does not exist yet; the same request may succeed later."""


class Busy(He3Error):
    """Too much work is waiting; the same request may succeed later."""
