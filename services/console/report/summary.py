"""A report on the terminal: the main figures in a few lines."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from services.console.client.time_format import duration
from services.console.client.words import counted

if TYPE_CHECKING:
    from schemas.maps import ReachScore
    from schemas.report import MissionReport


def summary_lines(report: MissionReport, files: Sequence[Path] = ()) -> list[str]:
    """The report in a few aligned lines of plain text."""
    counts = report.messages
    rows = [
        ("mission", f"{report.scenario}, region {report.region}, planner {report.planner}, kernel {report.kernel}, "
                    f"seed {report.seed}, {report.driver}"),
        _end(report),
        ("samples", f"{report.samples} of {report.samples_wanted} in {counted(report.rounds, 'round')}"),
        *_goal(report),
        *_accuracy(report),
        *_checked(report),
        *_mixed(report),
        *_learned(report),
        ("driven", f"{report.path_length_m:,.1f} m, drilled {report.drilled_m:.1f} m"),
        *_driving(report),
        *_closed(report),
        ("mission time", f"{duration(report.mission_time_s)} ({report.mission_time_s:,.0f} s), "
                         f"one-way light time {report.one_way_light_time_s:g} s"),
        ("wall time", duration(report.wall_time_s)),
        ("messages", f"{counts.sent} sent, {counts.delivered} delivered, {counts.retransmitted} retransmitted, "
                     f"{counts.lost} lost"),
        ("data", report.region_note),
    ]  # fmt: skip
    rows += [("written" if index == 0 else "", str(path)) for index, path in enumerate(files)]
    return [f"{name:<13} {value}" for name, value in rows]


def _end(report: MissionReport) -> tuple[str, str]:
    why = report.detail or "the ground gives no reason"
    if not report.completed:
        return "ended", f"NOT COMPLETED: {why}"
    if report.goal is not None and report.goal.holds:
        return "ended", "completed: the goal holds"
    return ("ended early:", why) if report.samples < report.samples_wanted else ("ended", "completed")


def _goal(report: MissionReport) -> list[tuple[str, str]]:
    goal = report.goal
    if goal is None:
        return []
    return [("goal", goal.text.removeprefix("the goal ") if goal.holds else f"NOT REACHED: {goal.text}")]


def _driving(report: MissionReport) -> list[tuple[str, str]]:
    driving = report.driving
    if driving is None:
        return []
    energy = f"{driving.energy_wh:,.0f} Wh, of which {driving.motion_wh:,.0f} Wh beside the base load"
    ground = f"{driving.climb_m:,.0f} m of rises, at most {driving.steepest_deg:.1f} deg"
    return [("driving", f"{driving.duration_h:.1f} h, {energy}; {ground}; planned for {driving.cost}")]


def _closed(report: MissionReport) -> list[tuple[str, str]]:
    ground = report.closed_ground
    if ground is None:
        return []
    reasons = {
        "too steep": ground.too_steep,
        "rough or closed in the region": ground.rough,
        "without a reference": ground.unknown,
        "keep-outs": ground.keep_outs,
        "beside closed ground": ground.margin,
    }
    closed = sum(reasons.values())
    why = ", ".join(f"{share:.1%} {reason}" for reason, share in reasons.items() if share > 0)
    cut_off = ground.cut_off / (1.0 - closed) if closed < 1.0 else 0.0
    reached = f"{cut_off:.1%} of the rest cannot be reached from the start"
    return [("closed ground", f"{closed:.1%}{why and f': {why}'}; {reached}")]


def _accuracy(report: MissionReport) -> list[tuple[str, str]]:
    if report.rmse_ppb is None or report.coverage_68 is None or report.coverage_95 is None:
        return [("RMSE", "not known: the map was not compared with a reference field")]
    one, two = f"{report.coverage_68:.1%}", f"{report.coverage_95:.1%}"
    within = f"{one} within the intervals of 68.3 %, {two} within those of 95.4 %"
    unknown = report.closed_ground is not None and report.closed_ground.unknown > 0
    cells = "all cells with a reference" if unknown else "all cells"
    lines = [("RMSE", f"{report.rmse_ppb:.4f} ppb over {cells}"), ("coverage", within)]
    return lines if report.within_reach is None else [*lines, ("within reach", reach_in_words(report.within_reach))]


def _checked(report: MissionReport) -> list[tuple[str, str]]:
    found = report.cross_validation
    if found is None:
        return []
    figures = f"{found.rmse_ppb:.4f} ppb, {found.within_68:.1%} and {found.within_95:.1%} within the intervals"
    return [("cross-check", f"each sample as all others predict it: {figures}")]


def reach_in_words(score: ReachScore) -> str:
    """The figures of the ground that the rover can reach, in one line."""
    return (
        f"{score.rmse_ppb:.4f} ppb over the {score.share:.1%} of these cells that the rover can reach; "
        f"{score.coverage_68:.1%} and {score.coverage_95:.1%} within the intervals"
    )


def _mixed(report: MissionReport) -> list[tuple[str, str]]:
    if report.kernel_weights is None:
        return []
    shown = {name: f"{weight:.0%}" for name, weight in report.kernel_weights.items()}
    return [("map mixes", ", ".join(f"{name} {share}" for name, share in shown.items() if share != "0%"))]


def _learned(report: MissionReport) -> list[tuple[str, str]]:
    found = report.learned
    if found is None:
        return []
    parts = []
    if found.noise_std_ppb > found.stated_noise_std_ppb:
        parts.append(f"noise of {found.noise_std_ppb:.3g} ppb, stated {found.stated_noise_std_ppb:g}")
    if found.stretch is not None and found.bearing_deg is not None:
        parts.append(
            f"the field is {found.stretch:.1f} times longer along {found.bearing_deg:03.0f} deg than across it "
            f"({found.stretched_weight:.0%} of the mixture)"
        )
    if found.varies_more_where is not None and found.skewed_weight is not None:
        parts.append(
            f"the field varies more where it is {found.varies_more_where} ({found.skewed_weight:.0%} of the mixture)"
        )
    if found.uneven_weight is not None:
        parts.append(
            f"the field varies more in some parts of the site than in others ({found.uneven_weight:.0%} of the mixture)"
        )
    return [("learned", "; ".join(parts))]
