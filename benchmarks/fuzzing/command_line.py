"""The command line with every flag of every command at random values: done, or refused in one line that names the flag.

Commands that keep running (`up`, `demo`, `web`, `bench`) always get at least one invalid value, so that none of them
starts; `run` runs a mission of one sample if all of its flags are valid.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import typer

from benchmarks.fuzzing import values
from services.console.__main__ import main
from services.console.cli.app import build

STAYING = frozenset({"up", "demo", "web", "bench", "watch"})
"""Commands that run until they are told to end."""
NEVER_RIGHT = {"scenario": "no/such/scenario.toml", "--rate": "-3", "--port": "99999", "name": "no-such-benchmark"}


class CommandLine:
    """The `he3` command, called in this process, in a separate folder where no mission runs."""

    name = "cli"

    def __init__(self, folder: Path) -> None:
        self._folder = folder / "working-directory"
        self._folder.mkdir()
        self._runtime = folder / "runtime-directory"
        self._runtime.mkdir(mode=0o700)
        self._commands = list(_leaves(typer.main.get_command(build()), ()))
        _, x = np.mgrid[0:12, 0:12].astype(float)
        np.savez(
            self._folder / "region.npz",
            he3_ppb=8 + np.sin(x / 3),
            traversable=np.ones((12, 12), bool),
            resolution_m=1.0,
        )
        (self._folder / "tiny.toml").write_text(
            'name = "tiny"\nregion = "region.npz"\nrounds = 1\nsamples_per_round = 1\nstart_m = [3.0, 3.0]\n'
            "[ground]\nplanning_s = 1.0\nclearance_m = 1.0\n"
        )

    def close(self) -> None:
        """Nothing to end."""

    def example(self, rng: Random) -> tuple[str, str | None]:
        """One command line: its words, and a line on its fault, None if there was none."""
        path, command = rng.choice(self._commands)
        words = [*path, *self._arguments(rng, path, command)]
        shown = " ".join(word if len(word) < 60 else f"{word[:57]}..." for word in words)
        before = _listing(self._folder)
        with _standing_in(self._folder, self._runtime):
            code, out, err = _called(words)
        return f"he3 {shown!r}", _wrong(code, err, before, _listing(self._folder), out)

    def _arguments(self, rng: Random, path: tuple[str, ...], command: Any) -> list[str]:
        words: list[str] = []
        for parameter in command.params:
            if parameter.name in ("help", "install_completion", "show_completion"):
                continue
            if parameter.param_type_name == "argument":
                if rng.random() < 0.93:
                    words += [self._word(rng, parameter) for _ in range(max(1, parameter.nargs))]
            elif rng.random() < 0.3:
                flag = rng.choice([*parameter.opts, *parameter.secondary_opts])
                words += (
                    [flag]
                    if parameter.is_flag
                    else [flag, *(self._word(rng, parameter) for _ in range(parameter.nargs))]
                )
        if path[-1] == "run":
            words.append("--in-process")
        if path[0] in STAYING:
            words = self._certainly_refused(rng, command, words)
        if rng.random() < 0.1:
            words.insert(rng.randint(0, len(words)), values.text(rng).replace("\0", ""))
        return words

    def _word(self, rng: Random, parameter: Any) -> str:
        kind = str(parameter.bare_type()).lower()
        if rng.random() < 0.35:
            word = values.text(rng)
        elif "int" in kind:
            word = str(values.integer(rng))
        elif "float" in kind or "number" in kind:
            word = repr(values.number(rng))
        elif parameter.name == "scenario":
            word = rng.choice(("tiny.toml", "tiny.toml", "short", "region.npz", "."))
        elif rng.random() < 0.3:
            word = rng.choice(
                ("tiny.toml", "region.npz", "new-file", "new-folder/new-file", "/dev/full", "/proc/version")
            )
        elif rng.random() < 0.4:
            word = rng.choice(
                ("1,2", "-5,-5", "3,3 4,4 5,3", "ground.pipeline=2", "rounds=0", "link.up.loss=2", "a=b", "=", "1:2")
            )
        else:
            word = values.text(rng)
        # As an operating system hands words over: without NUL, bytes that are no text as surrogates.
        return os.fsdecode(
            os.fsencode(word.replace("\0", "").encode("utf-8", "surrogateescape").decode("utf-8", "surrogateescape"))
        )

    def _certainly_refused(self, rng: Random, command: Any, words: list[str]) -> list[str]:
        names = [opt for parameter in command.params for opt in (*parameter.opts, parameter.name)]
        known = [name for name in NEVER_RIGHT if name in names]
        if not known:
            return [*words, "--no-such-flag"]
        for name in known:
            if name.startswith("-"):
                words = [*words, name, NEVER_RIGHT[name]]
        positional = [name for name in known if not name.startswith("-")]
        if positional:
            words = [
                NEVER_RIGHT[positional[0]],
                *[word for word in words if word.startswith("-") or rng.random() < 0.5],
            ]
        return words


def _leaves(command: Any, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command that does something, with the words that lead to it."""
    if hasattr(command, "commands"):
        for name, below in command.commands.items():
            yield from _leaves(below, (*path, name))
    else:
        yield path, command


class _Captured(io.TextIOWrapper):
    """A text stream over memory, with a `buffer` as a real one has."""

    def __init__(self) -> None:
        super().__init__(io.BytesIO(), encoding="utf-8", errors="surrogateescape", write_through=True)

    def text(self) -> str:
        self.flush()
        return bytes(self.buffer.getvalue()).decode("utf-8", "replace")  # type: ignore[attr-defined]


def _called(words: list[str]) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of that command line."""
    out, err = _Captured(), _Captured()
    standard_input = sys.stdin
    sys.stdin = io.StringIO("")
    try:
        with redirect_stdout(out), redirect_stderr(err):
            try:
                code = main(words)
            except SystemExit as end:
                code = end.code if isinstance(end.code, int) else 1
    finally:
        sys.stdin = standard_input
    return code, out.text(), err.text()


@contextmanager
def _standing_in(folder: Path, runtime: Path) -> Iterator[None]:
    """Within this context `folder` is the working directory, and run files are searched in the other folder."""
    here, before = Path.cwd(), os.environ.get("XDG_RUNTIME_DIR")
    os.chdir(folder)
    os.environ["XDG_RUNTIME_DIR"] = str(runtime)
    try:
        yield
    finally:
        os.chdir(here)
        if before is None:
            del os.environ["XDG_RUNTIME_DIR"]
        else:
            os.environ["XDG_RUNTIME_DIR"] = before


def _listing(folder: Path) -> dict[str, tuple[int, int]]:
    return {
        str(path.relative_to(folder)): (path.stat().st_size, path.stat().st_mtime_ns)
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def _wrong(code: int, err: str, before: dict[str, Any], after: dict[str, Any], out: str) -> str | None:
    lines = [line for line in err.splitlines() if line.strip()]
    if "Traceback" in err or "he3: defect:" in err:
        return f"exit {code}: {err[:400]!r}"
    if code not in (0, 1, 2):
        return f"exit {code}: {err[:300]!r}"
    if code == 2 and len(lines) != 1 and not (out and not lines):
        return f"exit 2 with {len(lines)} lines on standard error: {err[:300]!r}"
    if code == 1 and not lines:
        return "exit 1 without a line on standard error"
    if code and lines and not lines[-1].isprintable():
        return f"control characters in the error: {lines[-1][:200]!r}"
    if code == 2 and before != after:
        changed = sorted(set(before.items()) ^ set(after.items()))
        return f"exit 2, and files changed: {changed[:3]}"
    return None
