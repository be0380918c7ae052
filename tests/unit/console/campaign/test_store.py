"""The store: a row for each task, kept through everything."""

from __future__ import annotations

import sqlite3
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


@pytest.mark.parametrize(
    ("column", "content"),
    [
        ("labels", "no JSON"),
        ("labels", "[1]"),
        ("labels", '{"settings": 7}'),
        ("labels", "[" * 100_000),
        ("labels", b"{}"),
        ("result", '{"rmse_ppb": NaN}'),
        ("result", "[]"),
        ("error", b"\xff"),
    ],
)
def test_a_row_that_no_campaign_writes_is_refused_in_one_line(
    column: str, content: str | bytes, tmp_path: Path
) -> None:
    path = tmp_path / "s.sqlite"
    with Store(path, write=True) as store:
        store.write(task(1), Reply(DONE, {}))
    with sqlite3.connect(path) as database:
        database.execute(f"UPDATE rows SET {column} = ?", (content,))
    database.close()
    with Store(path, write=False) as store:
        for read in (lambda: list(store.rows()), lambda: store.row(task(1).key)):
            with pytest.raises(
                InvalidInput, match=r"s\.sqlite: expected rows that a campaign has written, got another"
            ):
                read()


@pytest.mark.parametrize("write", [False, True])
def test_a_view_in_place_of_a_table_is_never_asked(write: bool, tmp_path: Path) -> None:
    path = tmp_path / "s.sqlite"
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE about (name, value)")
        database.execute("INSERT INTO about VALUES ('format', '1')")
        database.execute(
            "CREATE VIEW Rows AS WITH RECURSIVE endless(key) AS (SELECT 1 UNION ALL SELECT key + 1 FROM endless) "
            "SELECT key, 'done' AS status, '{}' AS labels, NULL AS result, '' AS error, 0.0 AS wall_s, 1 AS current "
            "FROM endless"
        )
    database.close()
    with pytest.raises(InvalidInput, match="got views in place of its tables"):
        Store(path, write=write)
