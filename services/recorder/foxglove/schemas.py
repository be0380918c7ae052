"""Foxglove's message schemas: their descriptors for the schema records of a file, and messages encoded by them."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, Final

from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

FILE: Final = Path(__file__).with_name("schemas.binpb")
"""All descriptors, as scripts/make_foxglove_schemas.py writes them from Foxglove's own package."""
NAMES: Final = ("CompressedImage", "FrameTransform", "Grid", "LocationFix", "Log", "PointCloud", "SceneUpdate")
"""The schemas that are used."""
PACKAGE: Final = "foxglove"
ENCODING: Final = "protobuf"
"""Of the messages and of their schemas."""


@cache
def descriptors(name: str) -> bytes:
    """The schema of that name with all schemas that it depends on, as a serialised FileDescriptorSet."""
    files = {each.name: each for each in _all().file}
    chosen: dict[str, FileDescriptorProto] = {}

    def choose(file: str) -> None:
        if file not in chosen:
            for needed in files[file].dependency:
                choose(needed)
            chosen[file] = files[file]

    choose(f"{PACKAGE}/{name}.proto")
    found: bytes = FileDescriptorSet(file=chosen.values()).SerializeToString()
    return found


def encoded(name: str, fields: dict[str, Any]) -> bytes:
    """A message of that schema. fields: its values; messages in it as dictionaries, too."""
    message: bytes = _message_class(name)(**fields).SerializeToString()
    return message


@cache
def _all() -> FileDescriptorSet:
    return FileDescriptorSet.FromString(FILE.read_bytes())


@cache
def _pool() -> DescriptorPool:
    pool = DescriptorPool()  # apart from the library's own, where Foxglove's package may have put other versions
    for each in _all().file:
        pool.AddSerializedFile(each.SerializeToString())
    return pool


@cache
def _message_class(name: str) -> Any:
    return GetMessageClass(_pool().FindMessageTypeByName(f"{PACKAGE}.{name}"))
