"""``he3 map follow``: the map's feed, a line for each change."""

from __future__ import annotations

import json as json_format
import time
from typing import Annotated

import typer

from services.console.cli.flag_groups import with_flags
from services.console.cli.options import MAX_WAIT_S, AsJsonLines, within
from services.console.cli.session import Session


@with_flags
def follow(
    session: Session,
    limit_s: Annotated[
        float | None,
        typer.Option("--seconds", metavar="S", help="End after S seconds of wall time at the latest.",
                     callback=within(0, MAX_WAIT_S)),
    ] = None,
    json: AsJsonLines = False,
) -> None:  # fmt: skip
    """The map's feed: a line for each change as it comes, the present map first, until the mission is over."""
    from he3.errors import PeerUnreachable

    began, shown = time.monotonic(), -1
    with session.join() as client:
        client.declare_display()
        state = client.state()

        def ended() -> bool:
            state.refresh()
            if state.is_silent:
                raise PeerUnreachable(f"mission '{client.mission}': nothing heard for {state.silent_s:.0f} s")
            status = state.status
            return status is not None and status.is_over and shown >= status.map_revision

        for current in client.maps(limit_s, ended):
            shown = current.revision
            figures = {
                "revision": current.revision,
                "samples": current.samples,
                "mean_ppb": float(current.mean_ppb.mean(dtype=float)),
                "mean_std_ppb": float(current.std_ppb.mean(dtype=float)),
                "checksum": f"{current.checksum():08x}",
                "mission_time_ns": current.mission_time_ns,
            }
            if json:
                typer.echo(json_format.dumps(figures))
            else:
                typer.echo(
                    f"{time.monotonic() - began:8.2f} s  revision {current.revision}, {current.samples} samples, "
                    f"mean {figures['mean_ppb']:.4f} ppb, std {figures['mean_std_ppb']:.4f} ppb, {figures['checksum']}"
                )
