"""The link's process has room for connections, and says when it runs out of it."""

from __future__ import annotations

import resource
from pathlib import Path

import pytest

from services.link.open_files import LOOK_EVERY_S, MOST_FILES, OpenFiles, allow_connections


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        ((1024, 524_288), MOST_FILES),
        ((1024, resource.RLIM_INFINITY), MOST_FILES),
        ((1024, 4096), 4096),
        ((100_000, 524_288), 100_000),
        ((resource.RLIM_INFINITY, resource.RLIM_INFINITY), MOST_FILES),
    ],
)
def test_it_may_have_as_many_files_as_the_system_allows(
    limits: tuple[int, int], expected: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[int, int]] = []
    monkeypatch.setattr(resource, "getrlimit", lambda _: limits)
    monkeypatch.setattr(resource, "setrlimit", lambda _, wanted: asked.append(wanted))
    assert allow_connections() == expected
    assert asked == ([] if limits[0] >= expected or limits[0] == resource.RLIM_INFINITY else [(expected, limits[1])])


def test_it_goes_on_where_the_system_refuses_more(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise ValueError("not allowed to raise maximum limit")

    monkeypatch.setattr(resource, "getrlimit", lambda _: (256, 4096))
    monkeypatch.setattr(resource, "setrlimit", refuse)
    assert allow_connections() == 256


def test_it_warns_once_of_each_time_with_many_open_files() -> None:
    warnings: list[str] = []
    counts: list[int | None] = [10, 500, 700, None, 300, 249, 1000, None]
    files = OpenFiles(1000, warnings.append, lambda: counts.pop(0))
    for number in range(8):
        files.look((number + 1) * LOOK_EVERY_S)
        files.look((number + 1) * LOOK_EVERY_S + 1.0)
    assert not counts, "it looks once in each interval"
    assert [line.split(":")[0].split(" are")[0] for line in warnings] == ["500 of 1000 files", "1000 of 1000 files"]


def test_a_process_that_can_open_no_file_counts_as_full(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: Path) -> list[Path]:
        raise OSError(24, "Too many open files")

    monkeypatch.setattr(Path, "iterdir", full)
    warnings: list[str] = []
    OpenFiles(1000, warnings.append).look(LOOK_EVERY_S)
    assert warnings[0].startswith("1000 of 1000 files are open")
