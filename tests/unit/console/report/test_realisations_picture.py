"""The picture of realisations has the mean and up to five of them, on one scale and in metres."""

from __future__ import annotations

import numpy as np
import pytest

from services.console.report.realisations_picture import realisations_figure

PLACES = np.array([(12.0, 30.0), (80.0, 5.0)])


@pytest.mark.parametrize(("count", "panels"), [(1, 2), (5, 6), (9, 6)])
def test_the_mean_stands_beside_up_to_five_fields_on_one_scale(count: int, panels: int) -> None:
    fields = np.random.default_rng(1).normal(8.0, 1.0, (count, 4, 10))
    mean = np.full((8, 20), 8.0)
    figure = realisations_figure(fields, mean, (0.0, 100.0, 0.0, 40.0), PLACES, "as it is")
    images = [axis.images[0] for axis in figure.axes if axis.images]
    assert len(images) == panels
    assert len({image.get_clim() for image in images}) == 1
    assert np.array_equal(images[0].get_array(), mean)
    assert np.array_equal(images[1].get_array(), fields[0])
    assert {tuple(image.get_extent()) for image in images} == {(0.0, 100.0, 0.0, 40.0)}
    assert all(image.origin == "lower" for image in images)
    (dots,) = images[0].axes.lines
    assert np.array_equal(dots.get_xydata(), PLACES)


def test_without_samples_there_are_no_dots_and_a_picture_still() -> None:
    fields = np.random.default_rng(1).normal(8.0, 1.0, (5, 4, 10))
    figure = realisations_figure(fields, fields[0], (0.0, 100.0, 0.0, 40.0), np.empty((0, 2)), "as it is")
    assert len(figure.axes[0].lines[0].get_xdata()) == 0
