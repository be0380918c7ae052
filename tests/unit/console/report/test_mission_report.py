"""The report: what it counts and where each figure comes from."""

from __future__ import annotations

import base64

import numpy as np
import pytest

from he3.errors import He3Error, NotReady, PeerUnreachable
from schemas.ground import (
    FieldWarp,
    GoalForecast,
    GoalStatus,
    GroundStatus,
    KernelParameters,
    MissionPhase,
    MissionTrack,
    WeightedKernel,
)
from schemas.link import DirectionConditions, DirectionCounts, LinkConditions, LinkStatus
from schemas.maps import CrossValidation, MapLayer, MapRaster, MapScore, ReachScore
from schemas.report import MissionReport
from schemas.telemetry import SampleReport
from services.console.report.learned import kernel_weights, learned
from services.console.report.mission_report import Run, array_of, build_report, gather
from services.console.report.outputs import caption
from services.console.report.summary import summary_lines
from services.mission.scenario import Scenario

SCENARIO = Scenario(name="m", region="t1", rounds=1, samples_per_round=2)
START = SCENARIO.start_ns


def sample(number: int) -> SampleReport:
    return SampleReport(
        sample_id=f"s{number}", round=1, plan_revision=1, x_m=10.0 * number, y_m=5.0, depth_m=0.1, helium3_ppb=8.5,
        noise_std_ppb=0.1, measured_at=START + number * 1_500_000_000, driven_m=10.0 * number,
    )  # fmt: skip


def score(samples: int) -> MapScore:
    return MapScore(
        rmse_ppb=1.0 / samples, coverage_68=0.7, coverage_95=0.95, mean_std_ppb=0.9, revision=samples, samples=samples,
        mission_time_ns=START,
    )  # fmt: skip


def status(phase: MissionPhase, samples: int = 2) -> GroundStatus:
    return GroundStatus(
        phase=phase, planner="rrtstar", round=1, rounds=1, samples=samples, samples_total=2, driven_m=42.5,
        budget_m=None, plan_revision=1, plans_in_work=0, map_revision=2, mean_std_ppb=0.9, kernel=None, score=score(2),
        rover=None, rover_made_at=None, detail=f"{samples} of 2 samples are in the map",
    )  # fmt: skip


def link() -> LinkStatus:
    return LinkStatus(
        conditions=LinkConditions(down=DirectionConditions(one_way_light_time_s=3.0)),
        contact=True,
        contact_changes_at=None,
        up=DirectionCounts(offered=10, repeated=4, delivered=8, lost=1, dropped_queue_full=1),
        down=DirectionCounts(offered=20, delivered=15, lost=2, dropped_out_of_contact=3),
        in_flight=(),
        incarnation=1,
    )


def report(phase: MissionPhase = MissionPhase.COMPLETED, scored: bool = True, samples: int = 2) -> MissionReport:
    return reported(status(phase, samples), scored=scored)


def reported(
    found: GroundStatus,
    scenario: Scenario = SCENARIO,
    *,
    scored: bool = True,
    within_reach: ReachScore | None = None,
    checked: CrossValidation | None = None,
) -> MissionReport:
    track = MissionTrack(
        samples=(sample(1), sample(2)),
        driven_path_m=((25.0, 25.0), (10.0, 5.0), (20.0, 5.0)),
        planned_path_m=(),
        score_history=(score(2),),
    )
    run = Run("in-process", None, "made up", 123.5, 0.25)
    final = score(2).model_copy(update={"within_reach": within_reach})
    return build_report(scenario, run, found, track, link(), final if scored else None, checked)


def test_the_report_says_what_the_mission_did() -> None:
    made = report()
    assert made.completed
    assert (made.scenario, made.region, made.planner, made.kernel, made.seed) == ("m", "t1", "rrtstar", "auto", 1)
    assert (made.rounds, made.samples, made.path_length_m, made.drilled_m) == (1, 2, 42.5, 0.2)
    assert (made.rmse_ppb, made.coverage_68, made.coverage_95) == (0.5, 0.7, 0.95)
    assert (made.mission_time_s, made.wall_time_s, made.one_way_light_time_s) == (123.5, 0.25, 3.0)
    assert [(row.sample_id, row.measured_at_s) for row in made.sample_table] == [("s1", 1.5), ("s2", 3.0)]
    assert made.region_note == "made up"


def test_messages_of_both_directions_are_counted_together_and_what_is_dropped_is_lost() -> None:
    counts = report().messages
    assert (counts.sent, counts.delivered, counts.retransmitted, counts.lost) == (30, 23, 4, 7)
    assert counts.up.lost == 1


def test_a_mission_that_failed_is_not_reported_as_completed() -> None:
    made = report(MissionPhase.FAILED)
    assert not made.completed
    assert any("NOT COMPLETED" in line for line in summary_lines(made))


def test_a_mission_with_every_sample_that_was_wanted_is_completed() -> None:
    made = report()
    assert (made.samples, made.samples_wanted, made.detail) == (2, 2, "2 of 2 samples are in the map")
    lines = summary_lines(made)
    assert "ended         completed" in lines
    assert "samples       2 of 2 in 1 round" in lines


def test_a_mission_with_fewer_samples_than_wanted_ended_early_and_says_why() -> None:
    made = report(samples=1)
    assert (made.completed, made.samples, made.samples_wanted) == (True, 1, 2)
    lines = summary_lines(made)
    assert "ended early:  1 of 2 samples are in the map" in lines
    assert "samples       1 of 2 in 1 round" in lines


def test_without_a_truth_to_compare_with_the_report_claims_no_accuracy() -> None:
    made = report(scored=False)
    assert (made.rmse_ppb, made.coverage_68, made.coverage_95) == (None, None, None)
    assert any("not known" in line for line in summary_lines(made))
    assert "RMSE" not in caption(made)


class Ground:
    """A ground whose mission is over; it answers a query of the cross-validation with what it is given."""

    def __init__(self, checked: CrossValidation | He3Error) -> None:
        self._checked = checked

    def track(self) -> MissionTrack:
        return MissionTrack(samples=(sample(1), sample(2)), driven_path_m=(), planned_path_m=(), score_history=())

    def link(self) -> LinkStatus:
        return link()

    def raster(self, layer: MapLayer) -> MapRaster:
        data = base64.b64encode(np.ones((1, 1), dtype="<f4").tobytes()).decode()
        return MapRaster(
            layer=layer, rows=1, columns=1, resolution_m=1.0, dtype="<f4", data_base64=data, unit="ppb", revision=2,
            samples=2, mission_time_ns=START,
        )  # fmt: skip

    def score(self) -> MapScore:
        return score(2)

    def cross_validation(self) -> CrossValidation:
        if isinstance(self._checked, He3Error):
            raise self._checked
        return self._checked


CHECKED = CrossValidation(
    rmse_ppb=0.9174, bias_ppb=-0.01, score_rms=1.1, within_68=0.7, within_95=0.96, samples=(), revision=3,
    mission_time_ns=START,
)  # fmt: skip


def test_a_cross_validation_that_takes_too_long_costs_no_report() -> None:
    run = Run("in-process", None, "made up", 123.5, 0.25)
    found = status(MissionPhase.COMPLETED)
    told = gather(Ground(CHECKED), SCENARIO, found, run).report
    assert told.cross_validation is not None
    assert told.cross_validation.rmse_ppb == 0.9174
    silent = gather(Ground(PeerUnreachable("no answer within 30 s")), SCENARIO, found, run).report
    assert silent == told.model_copy(update={"cross_validation": None})
    with pytest.raises(NotReady):
        gather(Ground(NotReady("not yet")), SCENARIO, found, run)


def test_the_samples_check_the_map_with_a_reference_field_and_without() -> None:
    for scored in (True, False):
        made = reported(status(MissionPhase.COMPLETED), scored=scored, checked=CHECKED)
        assert made.cross_validation is not None
        assert (made.cross_validation.rmse_ppb, made.cross_validation.score_rms) == (0.9174, 1.1)
        line = "cross-check   each sample as all others predict it: 0.9174 ppb, 70.0% and 96.0% within the intervals"
        assert line in summary_lines(made)
    assert not any(line.startswith("cross-check") for line in summary_lines(report()))


def test_where_the_rover_cannot_go_everywhere_the_error_within_its_reach_is_told_too() -> None:
    reached = ReachScore(share=0.754, rmse_ppb=0.25, coverage_68=0.65, coverage_95=0.94)
    made = reported(status(MissionPhase.COMPLETED), within_reach=reached)
    told = "0.2500 ppb over the 75.4% of these cells that the rover can reach; 65.0% and 94.0% within the intervals"
    assert made.within_reach == reached
    assert f"within reach  {told}" in summary_lines(made)
    assert "RMSE 0.5000 ppb (0.2500 ppb within the rover's reach)" in caption(made)
    assert "reach" not in caption(report())
    assert not any(line.startswith("within reach") for line in summary_lines(report()))


def kernel(noise_ppb: float, *alternatives: WeightedKernel) -> KernelParameters:
    return KernelParameters(
        name="matern52", parameters={"variance": 1.0, "length_scale_m": 60.0}, noise_std_ppb=noise_ppb, mean_ppb=7.0,
        scale_ppb=1.5, alternatives=alternatives or None,
    )  # fmt: skip


def test_the_report_tells_what_was_learned_of_noise_and_lengths_and_nothing_where_nothing_was() -> None:
    round_one = WeightedKernel(weight=0.25, parameters={"variance": 1.0, "length_scale_m": 60.0})
    two = round_one.model_copy(update={"weight": 0.75, "parameters": {"stretch": 4.46, "bearing_deg": 41.2}})
    assert learned(None, 0.1) is None
    assert learned(kernel(0.1, round_one), 0.1) is None
    account = learned(kernel(0.3, round_one, two), 0.1)
    assert account is not None
    made = report().model_copy(update={"learned": account})
    assert MissionReport.model_validate_json(made.model_dump_json()) == made
    assert (
        "learned       noise of 0.3 ppb, stated 0.1; the field is 4.5 times longer along 041 deg than across it "
        "(75% of the mixture)"
    ) in summary_lines(made)
    assert not any(line.startswith("learned") for line in summary_lines(report()))


def test_the_report_tells_that_a_field_is_uneven_where_much_of_the_mixture_says_so() -> None:
    even = WeightedKernel(weight=0.5, parameters={"variance": 1.0, "length_scale_m": 60.0})
    uneven = even.model_copy(update={"parameters": {**even.parameters, "amplitude_extent_m": 500.0}})
    account = learned(kernel(0.1, even, uneven), 0.1)
    made = report().model_copy(update={"learned": account})
    told = "learned       the field varies more in some parts of the site than in others (50% of the mixture)"
    assert told in summary_lines(made)
    assert learned(kernel(0.1, even, uneven.model_copy(update={"weight": 0.3})), 0.1) is None


def test_the_report_tells_that_a_field_is_skewed_where_most_of_the_mixture_says_so() -> None:
    plain = WeightedKernel(weight=0.25, parameters={"variance": 1.0, "length_scale_m": 60.0})

    def warped(shift: float) -> WeightedKernel:
        warp = FieldWarp(centre_ppb=7.0, width_ppb=1.0, shift=shift, strength=0.3, noise_std_ppb=0.1)
        return plain.model_copy(update={"weight": 0.375, "warp": warp})

    assert learned(kernel(0.1, plain, warped(1.0)), 0.1) is None
    for shifts, where in (((1.0, 2.0), "high"), ((-1.0, -1.0), "low")):
        made = report().model_copy(
            update={"learned": learned(kernel(0.1, plain, *(warped(shift) for shift in shifts)), 0.1)}
        )
        assert MissionReport.model_validate_json(made.model_dump_json()) == made
        line = f"learned       the field varies more where it is {where} (75% of the mixture)"
        assert line in summary_lines(made)


def test_the_report_tells_which_kernels_the_map_mixes_and_nothing_where_it_has_one() -> None:
    own = WeightedKernel(weight=0.25, parameters={"variance": 1.0, "length_scale_m": 60.0})
    rough, little = (own.model_copy(update={"name": "matern12", "weight": weight}) for weight in (0.746, 0.004))
    assert kernel_weights(None) is None
    assert kernel_weights(kernel(0.1, own, own)) is None
    weights = kernel_weights(kernel(0.1, own, rough, little.model_copy(update={"name": "se"})))
    assert weights == {"matern12": 0.746, "matern52": 0.25, "se": 0.004}
    made = report().model_copy(update={"kernel_weights": weights})
    assert MissionReport.model_validate_json(made.model_dump_json()) == made
    assert "map mixes     matern12 75%, matern52 25%" in summary_lines(made)
    assert not any(line.startswith("map mixes") for line in summary_lines(report()))


@pytest.mark.parametrize(
    ("named", "mixed", "said"),
    [("auto", True, "auto"), ("auto", False, "matern52"), ("matern52", True, "matern52")],
)
def test_the_report_names_the_scenarios_kernel_where_the_map_is_a_mixture(named: str, mixed: bool, said: str) -> None:
    one = WeightedKernel(weight=0.5, parameters={"variance": 1.0, "length_scale_m": 60.0})
    found = status(MissionPhase.COMPLETED).model_copy(update={"kernel": kernel(0.1, *([one, one] if mixed else []))})
    assert reported(found, SCENARIO.changed(ground={"kernel": named})).kernel == said


def test_what_was_foreseen_of_samples_to_come_is_in_no_report_of_a_mission_that_is_over() -> None:
    foreseen = GoalForecast(samples=None, metres=None, worst_ppb=0.9, budget_m=None, reachable=False,
                            text="with the 4 samples left the greatest std is about 0.9 ppb")  # fmt: skip
    goal = GoalStatus(std_ppb=0.5, probability=0.95, area="everywhere", holds=False, worst_ppb=0.6, share=0.9,
                      weight=None, forecast=foreseen, text=f"greatest 0.600 ppb; {foreseen.text}")  # fmt: skip
    for phase, text in ((MissionPhase.COMPLETED, "greatest 0.600 ppb"), (MissionPhase.EXECUTING, goal.text)):
        found = status(phase).model_copy(update={"goal": goal})
        made = reported(found)
        assert made.goal is not None
        assert made.goal.text == text


def test_the_report_is_one_json_document_that_reads_back_equal() -> None:
    made = report()
    assert MissionReport.model_validate_json(made.model_dump_json()) == made


def raster(cells: int) -> MapRaster:
    values = np.arange(cells, dtype="<f4")
    return MapRaster(
        layer=MapLayer.MEAN, rows=2, columns=3, resolution_m=1.0, dtype="<f4", unit="ppb", revision=1, samples=0,
        data_base64=base64.b64encode(values.tobytes()).decode(), mission_time_ns=0,
    )  # fmt: skip


def test_a_layer_becomes_an_array_with_row_0_in_the_south() -> None:
    assert array_of(raster(6)).tolist() == [[0, 1, 2], [3, 4, 5]]


def test_a_layer_that_does_not_fill_its_cells_is_refused() -> None:
    with pytest.raises(He3Error, match="expected 2 x 3 cells, got 5 values"):
        array_of(raster(5))
