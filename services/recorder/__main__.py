"""The recorder service: ``python -m services.recorder SCENARIO --out FILE``. It only subscribes."""

from services.runtime.entry import leave, prepare_service

DEFAULT_FILE = "mission.mcap"
MIN_FLUSH_S = 0.2
"""Wall time between flushes: a kill loses the messages of at most this time."""


def main() -> int:
    """Exit code of the process, 1 if the recording lacks messages. The file is completed at every end but SIGKILL."""
    import sys
    from contextlib import ExitStack
    from pathlib import Path

    from services.recorder.about import about
    from services.recorder.files import open_recording
    from services.recorder.node import build_node
    from services.recorder.sink import RecordingSink
    from services.runtime.node import Node
    from services.runtime.options import Options
    from services.runtime.process import serve
    from services.runtime.service import Service

    sinks: list[RecordingSink] = []
    with ExitStack() as stack:

        def build(options: Options) -> Node:
            file = open_recording(options.out or Path(DEFAULT_FILE))
            sink = RecordingSink(file, options.scenario.name, MIN_FLUSH_S, about=about(options.scenario))
            sinks.append(stack.enter_context(sink))
            return build_node(options.scenario, sinks[-1])

        code = serve(Service("recorder", build, onlooker=True, completes_file=True))
    problems = [sink.problem for sink in sinks if sink.problem is not None]
    for problem in problems:
        sys.stderr.write(f"he3 recorder: {problem}\n")
    return code or int(bool(problems))


if __name__ == "__main__":
    prepare_service()
    leave(main())
