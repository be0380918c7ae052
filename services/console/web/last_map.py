"""The map at the mission's end, kept by the page's server: a run's services end with it, and a browser asks later.

What the page shows is fetched from the ground as soon as the mission is over: the history, the samples and paths, every
layer as a whole, and what browsers asked for of late. Until then the server counts as a display, for which a run waits.
What was not fetched is not answered from anything else.
"""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Final

from he3.errors import He3Error, PeerUnreachable
from schemas.maps import MapFormat, MapHistory, MapLayer, MapSite
from schemas.topics import MAP_BOX, MAP_HISTORY, MAP_POINT, MAP_RESOURCE, TRACK, Topic
from services.console.client.map_files import CUTOFF_PPB
from services.runtime.transport.request import request_from_selector

if TYPE_CHECKING:
    from schemas.ground import GroundStatus
    from schemas.wire import Wire
    from services.console.client.mission_client import MissionClient

TILE: Final = 512
"""Cells along the side of a tile of the page's map, as in static/raster.js."""
MAX_ASKED: Final = 40
"""Queries of late that are put again of the last map."""
SHOWN_WITHIN_S: Final = 4.0
"""Wall time within which the ground answers from the map that its last status names [s]."""
AGAIN_S: Final = 0.1
LAYERS: Final = tuple(layer for layer in MapLayer if layer not in (MapLayer.SAMPLES, MapLayer.PLAN))
AGAIN_OF_LAST: Final = (MAP_BOX, MAP_POINT, MAP_RESOURCE)
"""Topics whose queries of late are put again, the slowest last."""

Reply = tuple[bytes, bytes]
Key = tuple[str, str]


class LastMap:
    """The ground's answers, and those of its last map when it is gone. Methods may be called from any thread."""

    def __init__(self, mission: MissionClient) -> None:
        self._mission = mission
        self._lock = threading.Lock()
        self._asked: OrderedDict[tuple[str, str], tuple[Topic, dict[str, str]]] = OrderedDict()
        self._kept: dict[Key, Reply] = {}
        self._revision: int | None = None
        self._release: Callable[[], None] = lambda: None

    def follow(self) -> None:
        """Count as a display from now on."""
        self._release()
        self._release = self._mission.declare_display()

    def forget(self) -> None:
        """Another mission has begun."""
        with self._lock:
            self._asked.clear()
            self._kept, self._revision = {}, None

    def look(self, status: GroundStatus | None) -> None:
        """Fetch the last map, in another thread, if the mission is over; call this often."""
        if status is None or not status.is_over or status.map_revision == self._revision:
            return
        self._revision = status.map_revision
        threading.Thread(target=self._keep, args=(status.map_revision,), name="web-last-map", daemon=True).start()

    def answer(self, topic: Topic, parameters: dict[str, str]) -> Reply:
        """The ground's reply and its attachment, as `passed_on` has them; when it is gone, that of its last map."""
        self._note(topic, parameters)
        try:
            return self._mission.passed_on(topic, parameters)
        except PeerUnreachable:
            with contextlib.suppress(He3Error), self._lock:
                kept = self._kept.get(self._key(topic, parameters))
                if kept is not None:
                    return kept
            raise

    # --- inside -----------------------------------------------------------------------------------------------------

    def _note(self, topic: Topic, parameters: dict[str, str]) -> None:
        if topic not in AGAIN_OF_LAST or self._revision is not None:
            return
        of_last = {name: text for name, text in parameters.items() if name != "as_of"}
        key = topic.name, json.dumps(sorted(of_last.items()))
        with self._lock:
            self._asked[key] = topic, of_last
            self._asked.move_to_end(key)
            if len(self._asked) > MAX_ASKED:
                self._asked.popitem(last=False)

    def _key(self, topic: Topic, parameters: dict[str, str]) -> Key:
        """What tells one query from others of the last map; raises InvalidInput for parameters of no query."""
        request: Wire = request_from_selector(topic, parameters)
        if getattr(request, "as_of", None) == str(self._revision):
            request = request.model_copy(update={"as_of": None})
        return topic.name, request.model_dump_json()

    def _keep(self, revision: int) -> None:
        try:
            history = self._history(revision)
            for topic, parameters in self._wanted(history.site):
                try:
                    self._fetch(topic, parameters)
                except PeerUnreachable:
                    raise
                except He3Error:
                    continue  # a layer that this mission does not have
        except He3Error:
            return  # the ground was gone before: what it told stays
        finally:
            self._release()

    def _history(self, revision: int) -> MapHistory:
        """The history that has this revision, which the ground reports a moment before it answers from it."""
        give_up = time.monotonic() + SHOWN_WITHIN_S
        while True:
            history = MapHistory.model_validate_json(self._fetch(MAP_HISTORY, {})[0])
            if history.revisions[-1].revision >= revision or time.monotonic() > give_up:
                return history
            time.sleep(AGAIN_S)

    def _wanted(self, site: MapSite) -> Iterator[tuple[Topic, dict[str, str]]]:
        yield TRACK, {}
        with self._lock:
            asked = list(reversed(self._asked.values()))
        yield from (each for topic in AGAIN_OF_LAST for each in asked if each[0] is topic)
        for layer in LAYERS:
            yield MAP_BOX, whole(site, layer)

    def _fetch(self, topic: Topic, parameters: dict[str, str]) -> Reply:
        key = self._key(topic, parameters)
        with self._lock:
            kept = self._kept.get(key)
        if kept is None or topic is MAP_HISTORY:
            kept = self._mission.passed_on(topic, parameters)
            with self._lock:
                self._kept[key] = kept
        return kept


def whole(site: MapSite, layer: MapLayer) -> dict[str, str]:
    """Parameters of the tile with the whole site, coarse where it is large, as the page asks for it."""
    cell_m = site.resolution_m
    while max(site.rows, site.columns) * site.resolution_m > TILE * cell_m:
        cell_m *= 2
    side_m = TILE * cell_m
    asked: dict[str, object] = {
        "layer": layer.value, "format": MapFormat.PACKED.value, "x_min": 0, "y_min": 0,
        "x_max": min(side_m, site.columns * site.resolution_m), "y_max": min(side_m, site.rows * site.resolution_m),
        "resolution_m": cell_m,
    }  # fmt: skip
    if layer is MapLayer.EXCEEDANCE:
        asked["threshold"] = CUTOFF_PPB
    return {name: str(value) for name, value in asked.items()}
