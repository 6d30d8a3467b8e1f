"""Create the golden take and its figures: ``make golden``. Only when their contents must change."""

from __future__ import annotations

import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

from daemon.live.items import Pair
from daemon.recording.write.take_writer import TakeWriter
from daemon.rig.calibration_file import write_calibration
from drivers.protocols import Frame
from sim.render.render_pair import render_images
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.named_scenes import build

HERE = Path(__file__).parent
TAKE, FIGURES = HERE / "take.mcap", HERE / "golden.json"
T0_NS = 1_790_000_000_000_000_000
PERIODS = 36.0


def main() -> None:
    """Render two moments of the moving scene, record them, replay and bless."""
    layout, optics = RigLayout().scaled(0.375), Optics()
    pattern, volume = layout.pattern(PERIODS), layout.volume()
    calibration = HERE / "calibration.yaml"
    write_calibration(calibration, layout.calibration_for(optics), created=datetime(2026, 1, 1, tzinfo=UTC))
    TAKE.unlink(missing_ok=True)
    writer = TakeWriter(
        TAKE, session="golden", device="simulated", calibration_data=calibration.read_bytes(),
        pattern=pattern.as_mapping(), volume={"near_mm": volume.near_mm, "far_mm": volume.far_mm},
        compression="zstd", min_free_bytes=0,
    )  # fmt: skip
    for number in range(2):
        images = render_images(layout, build("moving"), pattern, optics, t_s=0.4 * number, seed=number)
        t_ns = T0_NS + number * 400_000_000
        left, right = (
            Frame(side, number, t_ns, t_ns + 10_000_000, "rgb8", image, optics.exposure_us)
            for side, image in zip(("left", "right"), images, strict=True)
        )
        writer.offer(Pair(left, right))
    writer.close()
    calibration.unlink()
    command = ["replay", str(TAKE), "--no-output", "--bless", str(FIGURES), "--set", "cluster_min_area=60"]
    start = "import sys; from daemon.cli.entry import main; sys.argv[0] = 'fringed'; main()"
    subprocess.run([sys.executable, "-c", start, *command], check=True)


if __name__ == "__main__":
    main()
