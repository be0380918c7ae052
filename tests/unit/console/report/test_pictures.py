"""Pictures: metres on the axes, one scale for reference and belief, everything drawn that was given."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from he3.errors import He3Error
from schemas.maps import MapScore
from services.console.report.pictures import MapPicture, map_figure, rmse_figure, save

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


def test_three_panels_in_metres_with_the_south_at_the_bottom() -> None:
    drawn = panels(map_figure(picture()))
    assert [axis.get_title(loc="left") for axis in drawn] == [
        "Reference field",
        "Belief: posterior mean",
        "Belief: standard deviation",
    ]
    for axis in drawn:
        assert axis.get_xlim() == (0.0, 120.0)
        assert axis.get_ylim() == (0.0, 80.0)
        assert axis.get_xlabel() == "east [m]"
        assert axis.get_aspect() == 1.0
        assert axis.images[0].origin == "lower"
    assert drawn[0].get_ylabel() == "north [m]"


def test_reference_and_belief_share_their_scale_and_the_standard_deviation_begins_at_nothing() -> None:
    truth, belief, std = (axis.images[0] for axis in panels(map_figure(picture())))
    assert truth.get_clim() == belief.get_clim() == (REFERENCE.min(), REFERENCE.max())
    assert truth.get_cmap().name == belief.get_cmap().name == "viridis"
    assert std.get_clim() == (0.0, 1.0)


def test_each_panel_has_a_colour_bar_with_its_unit() -> None:
    figure = map_figure(picture())
    labels = [axis.get_xlabel() for axis in figure.axes if axis not in panels(figure)]
    assert labels == ["helium-3 [ppb]", "helium-3 [ppb]", "std [ppb]"]


def test_the_path_is_drawn_on_the_belief_and_the_samples_on_both_of_its_panels() -> None:
    truth, belief, std = panels(map_figure(picture()))
    assert any(np.array_equal(line.get_xydata(), PATH) for line in belief.lines)
    for axis in (belief, std):
        assert any(np.array_equal(dots.get_offsets(), SAMPLES) for dots in axis.collections)
    assert not any(np.array_equal(line.get_xydata(), PATH) for line in truth.lines)


def test_without_a_reference_the_belief_stands_alone() -> None:
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
    with pytest.raises(He3Error, match="cannot write the picture"):
        save(rmse_figure("t", "n", []), tmp_path / "file" / "x.png")
