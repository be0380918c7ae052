"""The query process of the map: ``python -m services.ground.map.process SIDE ENDPOINT MISSION [IDENTITY]``.

The ground's process starts it and gives it each snapshot through a pipe (`services.runtime.queries.process`).
"""

import sys

from services.runtime.entry import prepare_process


def main() -> int:
    """Exit code of the process; it ends with its pipe."""
    from services.runtime.queries.pipe import say_alive

    say_alive()  # before the imports, which may take long
    from services.ground.map.feed_publisher import FeedPublisher
    from services.ground.map.queries import map_queries
    from services.runtime.queries.pipe_server import serve_from_pipe

    arguments, folder = sys.argv[1:4], sys.argv[4:]
    identity = None
    if folder:
        from pathlib import Path

        from services.runtime.trust.identity import load_identity

        identity = load_identity(Path(folder[0]))
    return serve_from_pipe(map_queries(), "ground", FeedPublisher(), arguments, identity)


if __name__ == "__main__":
    prepare_process()
    sys.exit(main())
