"""The recorder service: ``python -m services.recorder SCENARIO --out FILE``. It only subscribes."""

from services.runtime.entry import leave, prepare_service

DEFAULT_FILE = "mission.mcap"
MIN_FLUSH_S = 0.2
"""Wall time between flushes: what a kill can cost at most."""


def main() -> int:
    """Exit code of the process; the recording is finished whatever ends it, short of a kill."""
    from contextlib import ExitStack
    from pathlib import Path

    from services.recorder.files import open_recording
    from services.recorder.node import build_node
    from services.recorder.writer import RecordingWriter
    from services.runtime.drivers.wall_clock import Service
    from services.runtime.node import Node
    from services.runtime.options import Options
    from services.runtime.process import serve

    with ExitStack() as stack:

        def build(options: Options) -> Node:
            stream = stack.enter_context(open_recording(options.out or Path(DEFAULT_FILE)))
            writer = stack.enter_context(RecordingWriter(stream, options.scenario.name, MIN_FLUSH_S))
            return build_node(options.scenario, writer)

        return serve(Service("recorder", build, onlooker=True))


if __name__ == "__main__":
    prepare_service()
    leave(main())
