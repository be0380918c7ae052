"""A round is recalled once, and again only if it turns out that the recall came before it had begun."""

from __future__ import annotations

from schemas.commands import CommandKind
from schemas.plans import PlannedSample, RoundPlan
from services.ground.recall import RoundRecall
from services.ground.round_record import RoundRecord


def record(number: int, revision: int = 1, begun: bool = False) -> RoundRecord:
    sample = PlannedSample(sample_id=f"r{number}s1", x_m=9.0, y_m=0.0, depth_m=0.1)
    plan = RoundPlan(round=number, path_m=((0.0, 0.0), (9.0, 0.0)), samples=(sample,), information_nats=0.1)
    return RoundRecord(plan, revision, begun=begun)


def test_a_recall_aborts_the_round_and_is_sent_once() -> None:
    recall = RoundRecall()
    assert recall.due() is None
    assert recall.want(record(3, begun=True))
    command = recall.due()
    assert command is not None
    assert (command.kind, command.by) == (CommandKind.ABORT_ROUND, "ground (unverified)")
    assert recall.due() is None
    assert not recall.want(record(3, begun=True))
    assert recall.under_way


def test_a_rejected_recall_is_repeated_only_when_the_round_has_begun() -> None:
    recall = RoundRecall()
    recall.want(record(3))
    first = recall.due()
    assert first is not None
    assert not recall.ended("of-the-operator", False)
    assert recall.ended(first.command_id, carried_out=False)
    assert not recall.under_way
    assert not recall.want(record(3))
    assert recall.want(record(3, begun=True))
    again = recall.due()
    assert again is not None
    assert again.command_id != first.command_id


def test_after_a_recall_that_was_carried_out_only_a_later_round_is_recalled() -> None:
    recall = RoundRecall()
    recall.want(record(3))
    command = recall.due()
    assert command is not None
    recall.ended(command.command_id, carried_out=True)
    assert not recall.want(record(3, begun=True))
    assert recall.want(record(4, 2, begun=True))


def test_what_a_checkpoint_keeps_of_it_is_restored() -> None:
    recall, again = RoundRecall(), RoundRecall()
    recall.want(record(3))
    again.restore(recall.checkpoint())
    assert again.under_way
    assert again.due() == recall.due()
    assert not again.want(record(3, begun=True))
