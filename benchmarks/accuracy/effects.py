"""Effects that the simulator does not have: ``python -m benchmarks.accuracy.effects``, on the standard scene.

The light on the sensors, or the images, are changed between rendering and reconstruction: scattering, glare, blur,
displacement, unequal cameras and pixels. The exit code is 1 if a limit of the hard scenes is missed.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from benchmarks.common.tables import Table
from benchmarks.reconstruction.cases import HARD, Case, scaled
from pipeline.monitor.check.checked_reconstructor import CheckedReconstructor
from sim.evaluate.point_errors import PointErrors, point_errors
from sim.render import sensor
from sim.render.projected_light import projected_light
from sim.render.render_pair import image_sent, light_on_sensor, truths
from sim.rig.disturbance import TrueRig
from sim.scene.named_scenes import build

Light = NDArray[Any]
Image = NDArray[Any]
Effect = Callable[[Light, int], Light]
"""Of the light (H, W, 3) on a sensor and the camera's number, 0 left, 1 right."""

LARGEST_WRONG = 0.001
_SIGMA_RANGE = 0.8, 1.3
_BALANCE = np.array([1.25, 1.0, 0.8], np.float32)


def blurred(light: Light, pixels: float) -> Light:
    """Light after a Gaussian blur with this standard deviation."""
    return np.asarray(cv2.GaussianBlur(light, (0, 0), pixels), np.float32)


def displaced(light: Light, right: float, down: float) -> Light:
    """Light of an image displaced by fractions of a pixel, to about 1 / 32."""
    motion = np.array([[1, 0, right], [0, 1, down]], np.float32)
    size = light.shape[1::-1]
    return np.asarray(cv2.warpAffine(light, motion, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE))


def scattered(share: float, pixels: float) -> Effect:
    """A share of the light spread over its surroundings, in both cameras."""
    return lambda light, _: (1 - share) * light + share * blurred(light, pixels)


def of_right(change: Callable[[Light], Light]) -> Effect:
    """A change of the right camera's light alone."""
    return lambda light, camera: change(light) if camera else light


def _ambient(light: Light, _: int) -> Light:
    return np.asarray(light + 40 * np.linspace(0, 1, light.shape[1], dtype=np.float32)[:, None], np.float32)


def vignetted(left: float, right: float) -> Effect:
    """Corners darker than the middle by these shares, in proportion to the squared distance from it."""

    def effect(light: Light, camera: int) -> Light:
        y, x = (np.linspace(-1, 1, n, dtype=np.float32) for n in light.shape[:2])
        square = (y[:, None] ** 2 + x**2) / 2
        return np.asarray(light * (1 - (right if camera else left) * square)[..., None])

    return effect


def _together(light: Light, camera: int) -> Light:
    """A coloured lamp, scattering, coloured ambient light, vignetting, blur, and a right image of other brightness."""
    light = light * np.array([1.25, 1.05, 0.85], np.float32)
    light = 0.85 * light + 0.1 * blurred(light, 4) + 0.05 * blurred(light, 40) + np.array([18, 10, 4], np.float32)
    light = vignetted(0.15, 0.3)(light, camera)
    return blurred(0.8 * shining(0.06, 50)(light, camera) if camera else light, 0.5)


def _sideways(light: Light, camera: int) -> Light:
    x = np.linspace(0, 1, light.shape[1], dtype=np.float32)
    return np.asarray(light * (1 - 0.4 * (x if camera else 1 - x))[:, None])


def shining(deviation: float, pixels: float) -> Effect:
    """Surfaces that reflect otherwise to the right camera: factors with this deviation, alike over so many pixels."""

    def change(light: Light) -> Light:
        field = blurred(np.random.default_rng(31).standard_normal(light.shape[:2], dtype=np.float32), pixels)
        return np.asarray(light * np.exp(deviation * (field - field.mean()) / field.std())[..., None])

    return of_right(change)


TOGETHER = "lamp, ambient light, scattering, vignetting, brightness together"
LIGHT: dict[str, Effect] = {
    "none": lambda light, _: light,
    "scattering below the surface, 20 % over 3 pixels": scattered(0.2, 3),
    "the same, 40 % over 5 pixels": scattered(0.4, 5),
    "light from other surfaces, 30 % over 30 pixels": scattered(0.3, 30),
    "veiling glare of 8 %": lambda light, _: light + 0.08 * light.mean(),
    "right camera 0.6 times as bright": of_right(lambda light: np.float32(0.6) * light),
    "left camera 0.3 times as bright": lambda light, camera: light if camera else np.float32(0.3) * light,
    "coloured lamp, channels times 1.6, 1.3, 1.1": lambda light, _: light * np.array([1.12, 0.91, 0.77], np.float32),
    "coloured ambient light, 40, 20, 5 counts": lambda light, _: light + np.array([40, 20, 5], np.float32),
    TOGETHER: _together,
    "right image blurred by 1 pixel": of_right(lambda light: blurred(light, 1.0)),
    "both blurred by 1.2 pixels": lambda light, _: blurred(light, 1.2),
    "right image displaced by 0.3 pixels down": of_right(lambda light: displaced(light, 0, 0.3)),
    "ambient light across the image, up to 16 %": _ambient,
    "corners darker by 30 % in both images": vignetted(0.3, 0.3),
    "by 20 % in the left image, 50 % in the right": vignetted(0.2, 0.5),
    "darker to one side by 40 %, in the right to the other": _sideways,
    "right image brighter and darker in places, by 10 %": shining(0.1, 60),
    "right image brighter and darker in places, by 20 %": shining(0.2, 60),
    "right image brighter and darker in places, by 30 %": shining(0.3, 100),
    "right image displaced by 0.2 pixels along the baseline": of_right(lambda light: displaced(light, 0.2, 0)),
}


def _balanced(counts: Light, camera: int, case: Case) -> Light:
    """White balance of the right camera."""
    if not camera:
        return counts
    if counts.ndim == 3:
        return np.asarray(counts * _BALANCE)
    channels = np.reshape(sensor.MOSAICS[case.encoding], (2, 2))
    height, width = counts.shape
    return np.asarray(counts * np.tile(_BALANCE[channels], (-(-height // 2), -(-width // 2)))[:height, :width])


def _unequal(counts: Light, camera: int, _: Case) -> Light:
    gain, offset = (
        np.random.default_rng([77 + k, camera]).standard_normal(counts.shape, dtype=np.float32) for k in (0, 1)
    )
    return np.asarray(counts * (1 + 0.01 * gain) + 0.7 * offset)


def _hot(image: Image, camera: int) -> Image:
    return np.where(np.random.default_rng([79, camera]).random(image.shape) < 0.0005, np.uint8(255), image)


def _demosaiced(image: Image, _: int) -> Image:
    """As of a camera that interpolates colours from a mosaic."""
    raw = np.empty(image.shape[:2], np.uint8)
    for channel, (y, x) in ((0, (0, 0)), (1, (0, 1)), (1, (1, 0)), (2, (1, 1))):
        raw[y::2, x::2] = image[y::2, x::2, channel]
    return np.asarray(cv2.cvtColor(raw, cv2.COLOR_BayerBG2RGB))


def _gamma(image: Image, _: int) -> Image:
    return np.rint(255 * (image / 255.0) ** 0.85).astype(np.uint8)


INTERPOLATED = "colours interpolated from a mosaic by the camera"
COUNTS: dict[str, Callable[[Light, int, Case], Light]] = {
    "right camera's channels times 1.25, 1, 0.8": _balanced,
    "pixels of unequal gain and offset, 1 %, 0.7 counts": _unequal,
}
IMAGES: dict[str, Callable[[Image, int], Image]] = {
    "hot pixels, 0.05 %": _hot,
    "camera gamma of 0.85": _gamma,
    INTERPOLATED: _demosaiced,
}


def with_effect(name: str, lights: tuple[Light, Light], case: Case, seed: int = 0) -> list[Image]:
    """Both cameras' images of this light under an effect, read-only."""
    images = []
    for camera, light in enumerate(lights):
        changed = np.asarray(LIGHT.get(name, LIGHT["none"])(light, camera), np.float32)
        counts = sensor.exposed(changed, camera, case.optics, case.encoding)
        counts = COUNTS[name](counts, camera, case) if name in COUNTS else counts
        image = sensor.read_out(counts, case.optics, np.random.default_rng([seed, camera]), case.encoding)
        image = IMAGES[name](image, camera) if name in IMAGES else image
        image.setflags(write=False)
        images.append(image)
    return images


def errors_of(case: Case, names: Iterable[str]) -> Iterator[tuple[str, PointErrors, str]]:
    """Name, errors and verdict of a first pair under each of some effects."""
    rig, scene, volume = TrueRig.of(case.layout, case.optics), build(case.scene), case.layout.volume()
    light = projected_light(image_sent(case.pattern, case.optics, rig.projector.size), case.optics)
    left, right = (
        light_on_sensor(case.layout, rig.projector, scene, light, case.optics, 0.0, device)
        for device in (rig.left, rig.right)
    )
    truth, _ = truths(case.layout, scene, t_s=0.5e-6 * case.optics.exposure_us)
    for name in names:
        cloud = CheckedReconstructor(case.reconstructor(), "warn").reconstruct(*with_effect(name, (left, right), case))
        found = point_errors(cloud.xyz, cloud.sigma_mm, truth, (volume.near_mm, volume.far_mm))
        yield name, found, cloud.consistency.verdict if cloud.consistency is not None else ""


def table_of(case: Case) -> tuple[Table, list[str]]:
    """A row for each effect, and the limits that are missed."""
    columns = ["effect", "within 1 mm %", "wrong %", "false surfaces", "rms um", "error / sigma", "verdict"]
    table, missed = Table("effects", f"Effects that the simulator does not have, {case.name}", columns), []
    names = [name for name in (*LIGHT, *COUNTS, *IMAGES) if name != INTERPOLATED or case.encoding == "rgb8"]
    for name, found, verdict in errors_of(case, names):
        table.add(
            name, f"{100 * found.covered:.2f}", f"{100 * found.wrong:.3f}",
            f"{found.false_surfaces} of {found.false_points}", f"{1e3 * found.rms_mm:.0f}",
            f"{found.error_to_sigma:.2f}", verdict,
        )  # fmt: skip
        least, most = _SIGMA_RANGE
        wrong = found.wrong > LARGEST_WRONG or found.false_surfaces or not least <= found.error_to_sigma <= most
        if wrong or verdict == "inconsistent":
            missed.append(name)
    return table, missed


def main(given: list[str]) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scale", type=float, default=1.0, help="of images and fringes, 1 = 1024 x 820")
    parser.add_argument("--case", default="standard", help="name of a hard case")
    options = parser.parse_args(given)
    case = next((case for case in HARD if case.name == options.case), None)
    if case is None:
        parser.error(f"case {options.case!r}: expected one of {', '.join(case.name for case in HARD)}")
    table, missed = table_of(scaled(case, options.scale))
    console = Console(width=None if sys.stdout.isatty() else 170)
    table.print(console)
    for name in missed:
        console.print(f"MISSED {name}", highlight=False)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
