"""When the rover would have a command, and when its word would be back: closed forms."""

from __future__ import annotations

from schemas.commands import CommandKind, CommandPreview, Telecommand
from schemas.link import DirectionConditions, DirectionCounts, DutyCycle, LinkConditions, LinkStatus, Window
from services.console.client.previews import HEADER_BITS, CommandOutlook, Passage, passage
from services.mission.mission_time import SECOND

START = 1_000 * SECOND
NOW = START + 100 * SECOND


def link(forced: bool | None = None, **conditions: object) -> LinkStatus:
    far = DirectionConditions(one_way_light_time_s=10.0)
    given = LinkConditions.model_validate({"up": far, "down": far, **conditions})
    return LinkStatus(
        conditions=given, contact=True, contact_changes_at=None, up=DirectionCounts(), down=DirectionCounts(),
        in_flight=(), contact_forced=forced, incarnation=1,
    )  # fmt: skip


def after_s(found: Passage) -> tuple[float | None, float | None]:
    times = (found.received_at, found.word_back_at)
    first, second = (None if at is None else (at - NOW) / SECOND for at in times)
    return first, second


def test_in_contact_the_light_time_passes_each_way() -> None:
    assert after_s(passage(link(), START, NOW, 1)) == (10.0, 20.0)


def test_a_thin_link_adds_the_time_in_which_the_message_is_sent() -> None:
    thin = DirectionConditions(one_way_light_time_s=10.0, rate_bit_s=100.0)
    assert after_s(passage(link(up=thin), START, NOW, 1000)) == (20.0, 30.0)
    assert after_s(passage(link(down=thin), START, NOW, 1000)) == (10.0, 20.0 + HEADER_BITS / 100.0)


def test_out_of_contact_a_command_waits_for_the_next_window_and_its_word_for_the_one_after() -> None:
    windows = (Window(opens_s=200.0, closes_s=205.0), Window(opens_s=300.0, closes_s=400.0))
    assert after_s(passage(link(windows=windows), START, NOW, 1)) == (110.0, 210.0)


def test_a_command_that_no_longer_fits_into_a_contact_waits_for_the_next_one() -> None:
    thin = DirectionConditions(one_way_light_time_s=0.0, rate_bit_s=100.0)
    cycle = DutyCycle(period_s=1000.0, contact_s=105.0)
    assert after_s(passage(link(up=thin, down=thin, duty_cycle=cycle), START, NOW, 1000))[0] == 910.0


def test_in_a_black_out_no_time_is_known() -> None:
    assert after_s(passage(link(forced=False), START, NOW, 1)) == (None, None)


def test_the_outlook_says_drive_rounds_and_times_and_leaves_out_what_does_not_apply() -> None:
    drive = CommandPreview(
        command=Telecommand(command_id="a", kind=CommandKind.GO_TO, target_m=(3.0, 4.0)), at=NOW, effect="it drives",
        path_m=((0.0, 0.0), (3.0, 4.0)), drive_m=5.0, drive_s=50.0, energy_wh=7.0, charge_wh=90.0, closed_cells=1,
        rounds_given_up=(4,), samples_given_up=3, rounds_planned_anew=(5, 6),
    )  # fmt: skip
    rows = dict(CommandOutlook(drive, Passage(NOW + 10 * SECOND, None)).rows())
    assert rows["drive"] == "5.0 m in 50 s"
    assert rows["energy"] == "7 Wh for the drive; battery at 90 Wh after it"
    assert rows["closed"] == "1 closed cell on the way"
    assert rows["rounds"] == "round 4 given up with 3 samples, 2 rounds planned anew"
    assert rows["on rover"].startswith("in 10.0 s at the earliest (1970-")
    assert rows["word back"] == "not before contact returns"
    pause = drive.model_copy(update={"path_m": (), "rounds_given_up": (), "rounds_planned_anew": ()})
    assert dict(CommandOutlook(pause, Passage(None, None)).rows()).keys() == {"does", "rounds", "on rover", "word back"}
