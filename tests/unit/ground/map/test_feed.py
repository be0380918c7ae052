"""The map's feed: a reader ends with the ground's bytes, for any time of joining and any lost frames."""

from __future__ import annotations

import random

import numpy as np
import pytest

from he3.errors import InvalidInput
from services.ground.map.feed import FeedMap, FeedReader, FeedWriter

SHAPE = (40, 30)


def maps(count: int, seed: int) -> list[FeedMap]:
    rng = np.random.default_rng(seed)
    mean = rng.normal(8, 1, SHAPE).astype(np.float32)
    std = rng.uniform(0.1, 1, SHAPE).astype(np.float32)
    traversable = rng.random(SHAPE) > 0.2
    made = []
    for number in range(count):
        # A sample changes the map around it; now and then ground is closed.
        row, column = rng.integers(SHAPE[0]), rng.integers(SHAPE[1])
        mean, std, traversable = mean.copy(), std.copy(), traversable.copy()
        mean[max(0, row - 5) : row + 5, max(0, column - 5) : column + 5] += rng.normal()
        std[max(0, row - 5) : row + 5] *= np.float32(0.9)
        if number % 4 == 3:
            traversable[row, column] ^= True
        made.append(FeedMap(mean, std, traversable, 1.0, number + 1, number, number * 10))
    return made


def same(reader: FeedReader, expected: FeedMap) -> bool:
    got = reader.map
    return (
        got is not None
        and got.mean_ppb.tobytes() == expected.mean_ppb.tobytes()
        and got.std_ppb.tobytes() == expected.std_ppb.tobytes()
        and got.traversable.tobytes() == expected.traversable.tobytes()
        and (got.revision, got.samples, got.mission_time_ns, got.resolution_m)
        == (expected.revision, expected.samples, expected.mission_time_ns, expected.resolution_m)
    )


def ask_for_key(writer: FeedWriter, reader: FeedReader) -> None:
    key = writer.key()
    if key is not None:
        reader.take(key)


@pytest.mark.parametrize("seed", range(100))
def test_readers_that_join_late_or_lose_frames_end_with_the_grounds_arrays(seed: int) -> None:
    chance = random.Random(seed)
    shown = maps(chance.randint(5, 25), seed)
    writer, present = FeedWriter(epoch=seed), FeedReader()
    late, joins_at = FeedReader(), chance.randrange(len(shown))
    lossy, cut = FeedReader(), sorted(chance.sample(range(len(shown) + 1), 2))
    held_back: list[bytes] = []
    for number, current in enumerate(shown):
        # Before the first reader joins, no frames are wanted.
        frame = writer.take(current, wanted=number > 0 or chance.random() < 0.5)
        for reader, hears in (
            (present, True),
            (late, number >= joins_at),
            (lossy, not cut[0] <= number < cut[1] and chance.random() < 0.8),
        ):
            if not hears:
                continue
            if frame is not None:
                frames = [frame, *([frame] if chance.random() < 0.2 else [])]
                if reader is lossy and chance.random() < 0.3:
                    held_back.extend(frames)
                    continue
                for each in frames:
                    reader.take(each)
            # A query for a key frame takes time: several frames may come before its reply.
            if reader.needs_key and chance.random() < 0.7:
                ask_for_key(writer, reader)
        if held_back and chance.random() < 0.4:
            for each in chance.sample(held_back, len(held_back)):
                lossy.take(each)
            held_back.clear()
    beat = writer.beat()
    assert beat is not None
    for reader in (present, late, lossy):
        reader.take(beat)
        if reader.needs_key:
            ask_for_key(writer, reader)
        assert not reader.needs_key
        assert same(reader, shown[-1])


def test_a_delta_is_much_smaller_than_the_map() -> None:
    first, second = maps(2, seed=3)
    writer = FeedWriter(epoch=1)
    key = writer.take(first, wanted=True)
    delta = writer.take(second, wanted=True)
    assert key is not None
    assert delta is not None
    assert len(delta) < len(key) / 2


def test_another_start_of_the_feed_is_not_mixed_up_with_this_one() -> None:
    first, second, third = maps(3, seed=4)
    before, after, reader = FeedWriter(epoch=1), FeedWriter(epoch=2), FeedReader()
    reader.take(before.take(first, wanted=True) or b"")
    after.take(second, wanted=True)
    delta = after.take(third, wanted=True)
    assert delta is not None
    assert not reader.take(delta)
    assert reader.needs_key
    ask_for_key(after, reader)
    assert same(reader, third)


def test_damaged_and_foreign_frames_are_refused_and_change_nothing() -> None:
    first, second = maps(2, seed=5)
    writer, reader = FeedWriter(epoch=1), FeedReader()
    key = writer.take(first, wanted=True)
    assert key is not None
    reader.take(key)
    delta = writer.take(second, wanted=True)
    assert delta is not None
    damaged = bytearray(delta)
    damaged[-6] ^= 0x40
    for frame in (b"", b"HE3F", b"other bytes", key[:40], bytes(damaged), delta[:-9], b"HE3F\xff\xff\xff\xff"):
        with pytest.raises(InvalidInput, match="map feed"):
            reader.take(frame)
        assert same(reader, first)
    reader.take(delta)
    assert same(reader, second)
