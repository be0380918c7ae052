"""Write the descriptors of Foxglove's message schemas that a recording uses, as Foxglove's own package has them.

The package is in the extra ``viewers``. A recorder needs the file that is written, and not the package.

    python scripts/make_foxglove_schemas.py
"""

from __future__ import annotations

from foxglove import messages
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from services.recorder.foxglove.schemas import FILE, NAMES


def main() -> None:
    """One file with every descriptor once, each behind those that it depends on."""
    merged = FileDescriptorSet()
    known: set[str] = set()
    for name in NAMES:
        for each in FileDescriptorSet.FromString(getattr(messages, name).get_schema().data).file:
            if each.name not in known:
                known.add(each.name)
                merged.file.append(each)
    FILE.write_bytes(merged.SerializeToString())
    print(f"written to {FILE}: {len(known)} descriptors")


if __name__ == "__main__":
    main()
