"""The picture of a cross-validation shows every sample where it lies, and in the colour of its score."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from schemas.maps import CrossValidation, PredictedSample
from services.console.report.cross_validation_picture import FARTHEST, cross_validation_figure
from services.console.report.pictures import save


def found(scores: list[float]) -> CrossValidation:
    samples = tuple(
        PredictedSample(
            sample_id=f"s{k}", x_m=10.0 * k, y_m=5.0 * k, measured_ppb=8.0 + 0.5 * score, expected_ppb=8.0,
            std_ppb=0.5, score=score,
        )
        for k, score in enumerate(scores)
    )  # fmt: skip
    return CrossValidation(
        rmse_ppb=0.8, bias_ppb=-0.1, score_rms=1.1, within_68=0.7, within_95=0.95, samples=samples, revision=3,
        mission_time_ns=0,
    )  # fmt: skip


def test_each_sample_is_in_both_panels() -> None:
    left, right, bar = cross_validation_figure(found([0.5, -1.0, 2.0])).axes
    (line,) = [each for each in left.lines if each.get_marker() == "o"]
    assert np.array_equal(line.get_ydata(), [8.25, 7.5, 9.0])
    assert np.array_equal(line.get_xdata(), [8.0, 8.0, 8.0])
    (drawn,) = right.collections
    assert np.array_equal(drawn.get_offsets(), [(0.0, 0.0), (10.0, 5.0), (20.0, 10.0)])
    assert np.array_equal(drawn.get_array(), [0.5, -1.0, 2.0])
    assert drawn.get_clim() == (-FARTHEST, FARTHEST)
    assert left.get_xlim() == left.get_ylim()
    assert bar.get_ylim() == (-FARTHEST, FARTHEST)


@pytest.mark.parametrize(
    ("scores", "pointed"), [([1.0], "neither"), ([-4.0], "min"), ([4.0], "max"), ([-4.0, 4.0], "both")]
)
def test_the_colour_bar_is_pointed_where_scores_lie_beyond(scores: list[float], pointed: str) -> None:
    (drawn,) = cross_validation_figure(found(scores)).axes[1].collections
    assert drawn.colorbar.extend == pointed


def test_one_sample_and_equal_values_make_a_picture_too(tmp_path: Path) -> None:
    save(cross_validation_figure(found([0.0])), tmp_path / "one.png")
    save(cross_validation_figure(found([0.0, 0.0])), tmp_path / "two.png")
    assert (tmp_path / "one.png").read_bytes()[:4] == b"\x89PNG"
