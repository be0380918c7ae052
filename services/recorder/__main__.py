"""The recorder service: ``python -m services.recorder SCENARIO --out FILE``. It listens on Earth and says nothing."""

import sys
from pathlib import Path

from he3.errors import InvalidInput
from services.node import Node
from services.options import Options
from services.recorder.node import build_node
from services.recorder.writer import RecordingWriter
from services.run import Service
from services.serve import serve

DEFAULT_FILE = Path("mission.mcap")


def build(options: Options) -> Node:
    path = options.out or DEFAULT_FILE
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        stream = path.open("wb")
    except OSError as error:
        raise InvalidInput(f"{path}: cannot write the recording: {error.strerror}") from None
    return build_node(options.scenario, RecordingWriter(stream, options.scenario.name))


if __name__ == "__main__":
    sys.exit(serve(Service("recorder", build, onlooker=True)))
