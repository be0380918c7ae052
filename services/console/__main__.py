"""The operator's command ``he3``: every failure is one line on standard error and an exit code."""

from __future__ import annotations

from services.runtime.entry import forget_working_directory, leave, prepare_process

if __name__ == "__main__":
    forget_working_directory()

import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

# Everything else is imported inside `main`, so that Ctrl-C during the start is one line as well.

FAILED, BAD_INPUT, INTERRUPTED, TERMINATED = 1, 2, 130, 143
TRACEBACK = "HE3_TRACEBACK"
"""Environment variable that asks for the traceback of an unexpected error."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code of the command line: 0 done, 1 failed, 2 bad input, 130 interrupted, 143 terminated.

    Without arguments it runs this process's command line and ends the process, because a session that cannot close on a
    bad link leaves threads for which Python would wait for ever.
    """
    if arguments is None:
        leave(_ended(sys.argv[1:]))
    return _ended(list(arguments))


def _ended(words: list[str]) -> int:
    """Exit code of the command; every exception that may end it becomes one line."""
    try:
        prepare_process()
        from services.console.interruption import Terminated, ending_on_signals, told_to_end

        with ending_on_signals():
            try:
                return _run(words)
            except Terminated:
                return _say("terminated", TERMINATED)
            except Exception as error:
                # An exception that foreign code makes of a signal in one of its callbacks is no defect.
                told = told_to_end()
                if told is None and os.environ.get(TRACEBACK):
                    raise
                if told is None:
                    return _say(f"defect: {type(error).__name__}: {error} ({TRACEBACK}=1 shows where)", FAILED)
                return _say("interrupted", INTERRUPTED) if told == signal.SIGINT else _say("terminated", TERMINATED)
    except KeyboardInterrupt:
        return _say("interrupted", INTERRUPTED)


def _run(words: list[str]) -> int:
    import typer

    from he3.errors import He3Error, InvalidInput
    from services.console.cli.app import build
    from services.console.interruption import told_to_end

    _give_matplotlib_a_place()
    # typer carries its own copy of click and exports only the leaves of its exception tree.
    usage_error: Any = typer.BadParameter.__bases__[0]
    try:
        result = build()(words, prog_name="he3", standalone_mode=False)
        sys.stdout.flush()
    except usage_error as error:
        return _usage(error)
    except He3Error as error:
        if told_to_end() is not None:
            raise
        return _say(str(error), BAD_INPUT if isinstance(error, InvalidInput) else FAILED)
    except typer.Abort:
        return _say("interrupted", INTERRUPTED)
    except BrokenPipeError:
        return _enough_read()
    except OSError as error:
        if told_to_end() is not None or os.environ.get(TRACEBACK):
            raise
        what = error.strerror or type(error).__name__
        return _say(f"{error.filename}: {what}" if error.filename else f"the system refused: {what}", FAILED)
    except SystemExit as end:  # typer has seen it first
        if not isinstance(end.__context__, BrokenPipeError):
            raise
        return _enough_read()
    if result == INTERRUPTED:  # typer has seen it first
        return _say("interrupted", INTERRUPTED)
    return result if isinstance(result, int) else 0


def _give_matplotlib_a_place() -> None:
    """Name a folder for matplotlib's cache where there is no home: else it advises to do so in lines of its own, and
    leaves a folder among the temporary files each time.
    """
    from pathlib import Path

    from he3.errors import He3Error
    from services.console.client.run_file import folder

    with suppress(He3Error, OSError, RuntimeError):
        home = os.environ.get("HOME")
        if "MPLCONFIGDIR" not in os.environ and not os.access(home or Path.home(), os.W_OK):
            os.environ["MPLCONFIGDIR"] = str(folder() / "matplotlib")


def _enough_read() -> int:
    """Exit code when the reader of the output, such as `head`, closes it: 0."""
    # The interpreter flushes once more at its end.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def _usage(error: Any) -> int:
    from schemas.wire import printable

    message: str = error.format_message()
    if message.startswith("Usage: "):  # the help itself, for a command that was given nothing
        sys.stdout.write(message + "\n")
        return BAD_INPUT
    command = "he3" if error.ctx is None else error.ctx.command_path
    return _say(f"{printable(message)} (see {command} --help)", BAD_INPUT)


def _say(message: str, code: int) -> int:
    from schemas.wire import printable
    from services.console.interruption import note_last_line

    first, *rest = message.splitlines() or [""]
    with suppress(OSError):  # standard error is closed or full: the exit code tells as much
        sys.stderr.write(f"he3: {printable(first)}{' ...' if rest else ''}\n")
    if code in (INTERRUPTED, TERMINATED):
        note_last_line()
    return code


if __name__ == "__main__":
    sys.exit(main())
