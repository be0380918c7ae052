"""Pictures: metres on the axes, one scale for reference and map, and every given path and sample is drawn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from he3.errors import He3Error, InvalidInput
from schemas.maps import MapScore
from services.console.report.pictures import MapPicture, map_figure, region_figure, rmse_figure, save
from services.mission.regions import load_region

RNG = np.random.default_rng(5)
REFERENCE = 8.0 + RNG.normal(size=(40, 60))
MEAN = np.full((40, 60), 8.0)
STD = np.linspace(0.1, 1.0, 2400).reshape(40, 60)
OPEN = np.ones((40, 60), dtype=bool)
OPEN[10:20, 30:45] = False
PATH = np.array([[5.0, 5.0], [50.0, 30.0], [110.0, 70.0]])
SAMPLES = np.array([[50.0, 30.0], [110.0, 70.0]])


def picture(reference: np.ndarray[Any, Any] | None = REFERENCE) -> MapPicture:
    return MapPicture("title", "note", reference, MEAN, STD, OPEN, 2.0, PATH, SAMPLES, (5.0, 5.0))


def panels(figure: Any) -> list[Any]:
    return [axis for axis in figure.axes if axis.get_title(loc="left")]


def test_four_panels_in_metres_with_the_south_at_the_bottom() -> None:
    drawn = panels(map_figure(picture()))
    assert [axis.get_title(loc="left") for axis in drawn] == [
        "Reference field",
        "Map: posterior mean",
        "Map: standard deviation",
        "Error: map minus reference",
    ]
    for axis in drawn:
        assert axis.get_xlim() == (0.0, 120.0)
        assert axis.get_ylim() == (0.0, 80.0)
        assert axis.get_aspect() == 1.0
        assert axis.images[0].origin == "lower"
    assert [axis.get_xlabel() for axis in drawn] == ["", "", "east [m]", "east [m]"]
    assert [axis.get_ylabel() for axis in drawn] == ["north [m]", "", "north [m]", ""]


def test_reference_and_map_share_a_scale_that_leaves_out_extreme_cells() -> None:
    truth, mean, _, _ = (axis.images[0] for axis in panels(map_figure(picture())))
    assert truth.get_clim() == mean.get_clim() == pytest.approx(np.percentile(REFERENCE, (0.5, 99.5)))
    assert truth.get_cmap().name == mean.get_cmap().name == "viridis"


def test_the_scale_of_the_standard_deviation_shows_its_structure_away_from_the_samples() -> None:
    std = panels(map_figure(picture()))[2].images[0]
    assert std.get_clim() == pytest.approx(np.percentile(STD, (10.0, 99.5)))


def test_the_error_is_the_map_minus_the_reference_with_zero_in_the_middle_of_its_scale() -> None:
    error = panels(map_figure(picture()))[3].images[0]
    assert np.array_equal(error.get_array(), MEAN - REFERENCE)
    low, high = error.get_clim()
    assert low == -high < 0
    assert high == pytest.approx(np.percentile(np.abs(MEAN - REFERENCE), 99.0))


def test_each_panel_has_a_colour_bar_with_its_unit() -> None:
    bars = [axis.child_axes[0] for axis in panels(map_figure(picture()))]
    assert [bar.get_ylabel() for bar in bars] == ["helium-3 [ppb]", "helium-3 [ppb]", "std [ppb]", "error [ppb]"]


def test_the_path_is_drawn_on_the_mean_and_the_samples_on_mean_and_standard_deviation() -> None:
    truth, mean, std, _ = panels(map_figure(picture()))
    assert any(np.array_equal(line.get_xydata(), PATH) for line in mean.lines)
    for axis in (mean, std):
        assert any(np.array_equal(dots.get_offsets(), SAMPLES) for dots in axis.collections)
    assert not any(np.array_equal(line.get_xydata(), PATH) for line in truth.lines)


def test_keep_outs_are_outlined_on_every_panel_and_named() -> None:
    corners = ((2.0, 2.0), (8.0, 2.0), (5.0, 9.0))
    figure = map_figure(replace(picture(), keep_outs_m=(corners,)))
    for axis in panels(figure):
        assert any(np.array_equal(line.get_xydata(), [*corners, corners[0]]) for line in axis.lines)
    assert "keep-out" in [text.get_text() for text in figure.legends[0].get_texts()]
    assert "keep-out" not in [text.get_text() for text in map_figure(picture()).legends[0].get_texts()]


def test_without_a_reference_the_map_stands_alone() -> None:
    assert len(panels(map_figure(picture(reference=None)))) == 2


def test_a_mission_without_a_sample_has_a_picture_too() -> None:
    nothing = np.empty((0, 2))
    flat = MapPicture("t", "n", None, MEAN, np.zeros_like(STD), None, 2.0, nothing, nothing, (5.0, 5.0))
    assert len(panels(map_figure(flat))) == 2


def history(count: int) -> list[MapScore]:
    return [
        MapScore(
            rmse_ppb=1.0 / n, coverage_68=0.7, coverage_95=0.95, mean_std_ppb=0.9 / n, revision=n, samples=5 * n,
            mission_time_ns=0,
        )
        for n in range(1, count + 1)
    ]  # fmt: skip


def test_error_and_claimed_deviation_are_drawn_over_the_samples() -> None:
    axis = rmse_figure("title", "note", history(4)).axes[0]
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("samples", "helium-3 [ppb]")
    rmse, claimed = axis.lines
    assert list(rmse.get_xdata()) == [5, 10, 15, 20]
    assert list(rmse.get_ydata()) == [1.0, 1 / 2, 1 / 3, 1 / 4]
    assert list(claimed.get_ydata()) == pytest.approx([0.9, 0.45, 0.3, 0.225])
    assert axis.get_ylim()[0] == 0.0


def test_the_error_axis_begins_near_curves_that_stay_far_from_zero() -> None:
    scores = [score.model_copy(update={"rmse_ppb": 0.8, "mean_std_ppb": 0.9}) for score in history(3)]
    assert rmse_figure("title", "note", scores).axes[0].get_ylim() == pytest.approx((0.64, 0.972))


def test_a_mission_that_took_no_sample_has_a_diagram_too() -> None:
    scores = [score.model_copy(update={"samples": 0}) for score in history(1)]
    assert rmse_figure("title", "note", scores).axes[0].get_xlim() == pytest.approx((0.0, 1.02))


def test_no_rounds_make_an_empty_diagram() -> None:
    assert rmse_figure("title", "note", []).axes[0].get_xlabel() == "samples"


def test_equal_figures_are_equal_files(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        save(map_figure(picture()), tmp_path / name)
    first, second = ((tmp_path / name).read_bytes() for name in ("a.png", "b.png"))
    assert first == second
    assert first.startswith(b"\x89PNG\r\n\x1a\n")


def test_a_picture_that_cannot_be_written_says_where(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidInput, match="cannot write the picture"):
        save(rmse_figure("t", "n", []), tmp_path / "file" / "x.png")


def test_a_full_disk_is_no_mistake_of_the_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("services.console.report.pictures.open_output", full)
    with pytest.raises(He3Error, match="cannot write the picture: No space left on device") as refusal:
        save(rmse_figure("t", "n", []), tmp_path / "x.png")
    assert not isinstance(refusal.value, InvalidInput), "the same command may succeed later"


def test_a_title_of_another_s_making_is_text_and_no_formula(tmp_path: Path) -> None:
    words = r"ground at $\frac$"
    region = replace(load_region("t1"), title=words, provenance=words)
    figures = (
        region_figure(region),
        map_figure(replace(picture(), title=words, note=words)),
        rmse_figure(words, words, []),
    )
    for number, figure in enumerate(figures):
        save(figure, tmp_path / f"{number}.png")
        assert (tmp_path / f"{number}.png").stat().st_size > 0
