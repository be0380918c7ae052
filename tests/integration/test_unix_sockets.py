"""A router at a Unix socket deletes no file but what a router has left."""

from __future__ import annotations

import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from he3.errors import InvalidInput
from schemas.topics import Side
from services.runtime.transport.opening import open_client, open_router


def a_file(place: Path) -> None:
    place.write_text("precious")


def a_link(place: Path) -> None:
    a_file(place.with_name("elsewhere"))
    place.symlink_to("elsewhere")


def a_socket(place: Path) -> None:
    with socket.socket(socket.AF_UNIX) as other:
        other.bind(str(place))


def a_folder(place: Path) -> None:
    place.mkdir()


def a_file_beside_it(place: Path) -> None:
    place.with_name(f"{place.name}.lock").write_text("precious")


def files(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Kind and content of each file in the folder."""
    return {
        each.name: (each.lstat().st_mode, each.read_bytes() if each.is_file() else b"") for each in folder.iterdir()
    }


@pytest.mark.parametrize("put", [a_file, a_link, a_socket, a_folder, a_file_beside_it])
def test_what_another_program_has_at_the_path_stays(
    put: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    put(Path("earth"))
    before = files(tmp_path)
    for path in ("./earth", f"{tmp_path}/earth", "./earth?rel=1", "./earth#bind=x"):
        with pytest.raises(InvalidInput, match="expected no file"):
            open_router(Side.EARTH, f"unixsock-stream/{path}")
    assert files(tmp_path) == before


def test_a_router_takes_the_place_of_one_that_was_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # the path of a socket has 108 bytes at most
    a_socket(Path("earth"))
    Path("earth.lock").touch()
    for _ in range(2):
        router = open_router(Side.EARTH, "unixsock-stream/earth")
        open_client(Side.EARTH, "unixsock-stream/earth").close()  # type: ignore[no-untyped-call]
        router.close()  # type: ignore[no-untyped-call]
