"""Write docs/foxglove-layout.json: mean and standard deviation side by side, the picture and the log beside them.

Needs Foxglove's package (extra ``viewers``), which knows the format.

    python scripts/make_foxglove_layout.py
"""

from __future__ import annotations

import json
from pathlib import Path

from foxglove import layouts

from services.recorder.foxglove.scene import SITE

TARGET = Path(__file__).parents[1] / "docs" / "foxglove-layout.json"
MIDDLE_M = (250.0, 250.0, 0.0)  # of an embedded region
DISTANCE_M = 700.0  # of the camera: it sees the whole region


def grid(field: str, visible: bool, low: str, high: str) -> layouts.BaseRendererGridTopicSettings:
    """The settings of a layer of the map."""
    return layouts.BaseRendererGridTopicSettings(
        visible=visible,
        color_mode="gradient",
        color_field=field,
        gradient=(low, high),
        explicit_alpha=1.0,
        draw_behind=True,
    )


def scene(title: str, layer: str) -> layouts.ThreeDeePanel:
    """A view from above, north up, of one layer with samples, paths, keep-outs and the rover."""
    samples = layouts.BaseRendererPointCloudTopicSettings(
        visible=True, color_mode="colormap", color_field="helium3_ppb", color_map="turbo", point_size=7.0
    )
    shown = layouts.BaseRendererSceneUpdateTopicSettings(visible=True)
    return layouts.ThreeDeePanel(
        title=title,
        config=layouts.ThreeDeeConfig(
            follow_tf=SITE,
            fixed_frame=SITE,
            follow_mode="follow-none",
            camera_state=layouts.ThreeDeeCameraState(
                distance=DISTANCE_M, perspective=False, phi=0.0, theta_offset=0.0, target_offset=MIDDLE_M,
            ),
            scene=layouts.BaseRendererSceneSettings(
                sync_camera=True, transforms=layouts.BaseRendererTransforms(show_label=False, visible=False)
            ),
            topics={
                "/map/mean": grid("mean_ppb", layer == "mean", "#440154ff", "#fde725ff"),
                "/map/std": grid("std_ppb", layer == "std", "#000004ff", "#fcfdbfff"),
                "/map/open": grid("open", False, "#5b2c2cff", "#d9d4c7ff"),
                "/samples": samples,
                **dict.fromkeys(("/rover", "/rover/path", "/plan", "/keep_outs"), shown),
            },
        ),
    )  # fmt: skip


def main() -> None:
    """The file, indented for people."""
    picture = layouts.ImagePanel(
        title="Picture", config=layouts.ImageConfig(image_mode=layouts.ImageModeConfig(image_topic="/map/picture"))
    )
    log = layouts.LogPanel(title="Log", config=layouts.LogConfig(topic_to_render="/log", show_level=True))
    split, item = layouts.SplitContainer, layouts.SplitItem
    above = split(direction="row", items=[
        item(content=scene("Helium-3, mean", "mean")), item(content=scene("Helium-3, standard deviation", "std")),
    ])  # fmt: skip
    below = split(direction="row", items=[item(content=picture), item(proportion=3, content=log)])
    whole = split(direction="column", items=[item(proportion=3, content=above), item(content=below)])
    text = json.dumps(json.loads(layouts.Layout(content=whole).to_json()), indent=2)
    TARGET.write_text(f"{text}\n", encoding="utf-8")
    print(f"written to {TARGET}")


if __name__ == "__main__":
    main()
