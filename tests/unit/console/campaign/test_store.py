"""The store: a row for each task, kept through everything."""

from __future__ import annotations

from pathlib import Path

import pytest

from he3.errors import InvalidInput
from services.console.campaign.store import Store
from services.console.campaign.task import DONE, FAILED, LOST, Reply, Task


def task(number: int, software: str = "this") -> Task:
    return Task("some:work", {"number": number}, software, {"seed": number})


def test_a_row_with_a_result_stays_and_one_with_an_error_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "s.sqlite"
    with Store(path, write=True) as store:
        store.write(task(1), Reply(DONE, {"figure": 0.1}))
        store.write(task(1), Reply(DONE, {"figure": 0.2}))
        store.write(task(2), Reply(FAILED, error="no luck"))
        store.write(task(2), Reply(DONE, {"figure": 0.3}))
        store.write(task(3), Reply(FAILED, error="no luck"))
        with pytest.raises(ValueError, match="lost"):
            store.write(task(4), Reply(LOST))
    with Store(path, write=False) as store:
        found = {row.labels["seed"]: (row.status, row.result, row.error) for row in store.rows()}
        assert store.rewritten == 2
    assert found == {1: (DONE, {"figure": 0.1}, ""), 2: (DONE, {"figure": 0.3}, ""), 3: (FAILED, None, "no luck")}


def test_rows_of_another_study_or_software_stay_but_are_not_reported(tmp_path: Path) -> None:
    with Store(tmp_path / "s.sqlite", write=True) as store:
        for each in (task(1), task(2, "older")):
            store.write(each, Reply(DONE, {}))
        assert store.begin([task(1), task(3)]) == {task(1).key: DONE}
        assert [row.key for row in store.rows()] == [task(1).key]
        assert store.others == 1
        assert store.begin([task(2, "older")]) == {task(2, "older").key: DONE}
        assert [row.key for row in store.rows()] == [task(2, "older").key]


def test_one_campaign_at_a_time_writes_a_store_while_others_read_it(tmp_path: Path) -> None:
    path = tmp_path / "s.sqlite"
    with Store(path, write=True) as store:
        with pytest.raises(InvalidInput, match="no other campaign writes"):
            Store(path, write=True)
        store.write(task(1), Reply(DONE, {}))
        with Store(path, write=False) as reader:
            assert len(list(reader.rows())) == 1


def test_another_file_is_no_store(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="got no such file"):
        Store(tmp_path / "none.sqlite", write=False)
    other = tmp_path / "other.sqlite"
    other.write_text("something else, which is long enough to be taken for a database" * 20)
    for write in (False, True):
        with pytest.raises(InvalidInput, match="expected a campaign's store"):
            Store(other, write=write)
    assert other.read_text().startswith("something else")
