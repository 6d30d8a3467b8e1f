"""Images of every kind are read alike from files, folders and takes; unreadable ones are named."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.apps.calibration.errors import SourceError
from daemon.apps.calibration.images.image_files import demosaic, read_image
from daemon.apps.calibration.images.image_size import image_size
from daemon.apps.calibration.views.open_source import CaptureFolder, open_source
from daemon.apps.calibration.views.take_source import TakeSource
from daemon.apps.calibration.views.view import View, white_frame
from daemon.recording.write.part_writer import PartWriter
from drivers.protocols import SIDES, Frame
from pipeline.decode.raw_image import BAYER
from pipeline.pattern.projected_frames import Uniform
from pipeline.pattern.sequence import projector_sequence
from tests.daemon.apps.calibration import drawn

RNG = np.random.default_rng(0)


def check_progress(completed: int, total: int) -> None:
    assert 0 <= completed <= total


@pytest.mark.parametrize("shape", [(90, 120), (90, 120, 3)])
@pytest.mark.parametrize(("suffix", "depth"), [("png", 8), ("png", 16), ("tiff", 8), ("tiff", 16), ("bmp", 8)])
def test_a_lossless_image_is_read_as_it_was_written(
    tmp_path: Path, suffix: str, depth: int, shape: tuple[int, ...]
) -> None:
    image = RNG.integers(0, 1 << depth, shape).astype(np.uint8 if depth == 8 else np.uint16)
    path = tmp_path / f"p.{suffix}"
    drawn.write_png(path, image)
    assert image_size(path.read_bytes()) == (120, 90)
    np.testing.assert_array_equal(read_image(path), image)


def test_a_jpeg_is_read_in_the_order_of_its_colours(tmp_path: Path) -> None:
    image = np.full((80, 100, 3), (200, 90, 30), np.uint8)
    drawn.write_png(tmp_path / "p.jpg", image)
    assert image_size((tmp_path / "p.jpg").read_bytes()) == (100, 80)
    assert np.abs(read_image(tmp_path / "p.jpg").astype(int) - image).max() < 4


def test_transparency_is_left_out(tmp_path: Path) -> None:
    image = RNG.integers(0, 256, (70, 80, 4)).astype(np.uint8)
    assert cv2.imwrite(str(tmp_path / "p.png"), image)
    np.testing.assert_array_equal(read_image(tmp_path / "p.png"), image[..., 2::-1])


def test_an_image_that_would_decode_to_gigabytes_is_rejected_by_its_header(tmp_path: Path) -> None:
    drawn.write_png(tmp_path / "p.png", np.zeros((70, 80), np.uint8))
    data = bytearray((tmp_path / "p.png").read_bytes())
    data[16:24] = (60_000).to_bytes(4, "big") * 2
    (tmp_path / "p.png").write_bytes(data)
    with pytest.raises(SourceError, match=r"p.png: 60000 x 60000 pixels; expected"):
        read_image(tmp_path / "p.png")


@settings(max_examples=200, deadline=None)
@given(st.sampled_from([b"\x89PNG\r\n\x1a\n", b"\xff\xd8", b"II*\0", b"MM\0*", b"BM", b""]), st.binary(max_size=200))
def test_the_header_of_any_file_is_read_without_an_error(head: bytes, rest: bytes) -> None:
    size = image_size(head + rest)
    assert size is None or len(size) == 2


@pytest.mark.parametrize("encoding", BAYER)
@pytest.mark.parametrize("kind", [np.uint8, np.float32])
def test_a_mosaic_of_uniform_colour_gets_that_colour(encoding: str, kind: type) -> None:
    color = np.array([200, 100, 50])
    raw = color[np.tile(np.array(BAYER[encoding]), (16, 16))].astype(kind)
    image = demosaic(raw, encoding).astype(np.float64)
    np.testing.assert_allclose(image[8, 8] / image[8, 8].sum(), color / color.sum(), atol=1e-3)


def take_of(folder: Path, path: Path, *, first: int, lost: tuple[int, ...] = ()) -> None:
    """Write the capture folder as a take whose first trigger is ``first``; some triggers are lost."""
    description = json.loads((folder / "capture.json").read_text())
    attachments = {"pattern.json": json.dumps(description["sequence"]).encode()}
    metadata = {"session": "s", "device": "d", "first_pattern_sequence": str(first)}
    writer = PartWriter(path, attachments=attachments, metadata=metadata, created_ns=1)
    trigger = 0
    for view in sorted(folder.glob("view_*")):
        for n in range(len(description["sequence"]["frames"])):
            if trigger not in lost:
                number = (first + trigger) % (1 << 32)
                images = [read_image(view / f"{side}_{n:02d}.png") for side in SIDES]
                writer.write(
                    *(Frame(s, number, trigger, trigger, "mono8", p) for s, p in zip(SIDES, images, strict=True))
                )
            trigger += 1
    writer.finish()


def same(a: View, b: View) -> None:
    assert a.encoding == b.encoding
    for one, other in zip((*a.left, *a.right), (*b.left, *b.right), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("first", [0, pytest.param(1000, marks=pytest.mark.long), (1 << 32) - 30])
def test_a_take_gives_the_same_views_as_the_folder(tmp_path: Path, capture_folder: Path, first: int) -> None:
    take_of(capture_folder, tmp_path / "t.mcap", first=first)
    folder, take = CaptureFolder(capture_folder), open_source(tmp_path / "t.mcap")
    assert take.sequence is not None
    assert folder.sequence is not None
    assert take.sequence.as_mapping() == folder.sequence.as_mapping()
    for only in (None, 2):
        ours, theirs = list(take.views(check_progress, only=only)), list(folder.views(check_progress, only=only))
        assert len(ours) == len(theirs) == 4
        for one, other in zip(ours, theirs, strict=True):
            same(one, other)


def test_a_view_with_a_lost_frame_is_left_out_with_its_reason(tmp_path: Path, capture_folder: Path) -> None:
    count = len(json.loads((capture_folder / "capture.json").read_text())["sequence"]["frames"])
    take_of(capture_folder, tmp_path / "t.mcap", first=7, lost=(count + 3,))
    take = TakeSource(tmp_path / "t.mcap")
    assert [view.name for view in take.views(check_progress)] == ["view_00", "view_02", "view_03"]
    assert take.left_out == ["view_01: frame 3 of its sequence was lost (1 in total)"]


def test_marks_are_detected_in_the_brightest_uniform_frame() -> None:
    sequence = projector_sequence((480, 384))
    frame = sequence.frames[white_frame(sequence)]
    assert isinstance(frame, Uniform)
    assert frame.color == max(f.color for f in sequence.frames if isinstance(f, Uniform))
    assert white_frame(None) == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: (f / "capture.json").write_text("{"), r"capture.json: not JSON"),
        (lambda f: (f / "capture.json").write_text("{}"), r"capture.json: encoding is None, expected one of rgb8"),
        (lambda f: (f / "view_01" / "right_03.png").unlink(), r"right_03.png: No such file"),
        (lambda f: [shutil.rmtree(p) for p in f.glob("view_*")], r"no folder view_00"),
        (
            lambda f: drawn.write_png(f / "view_00" / "left_00.png", np.zeros((320, 400, 3), np.uint8)),
            r"left_00.png: colour image of uint8, but capture.json specifies mono8",
        ),
        (
            lambda f: drawn.write_png(f / "view_02" / "left_01.png", np.zeros((300, 400), np.uint8)),
            r"left_01.png: 400 x 300 pixels, but .*left_00.png has 400 x 320",
        ),
    ],
)
def test_the_problem_of_a_capture_folder_is_named(
    tmp_path: Path, capture_folder: Path, change: object, message: str
) -> None:
    folder = tmp_path / "capture"
    shutil.copytree(capture_folder, folder)
    change(folder)  # type: ignore[operator]
    with pytest.raises(SourceError, match=message):
        list(CaptureFolder(folder).views(check_progress))


def test_a_folder_without_images_is_rejected_with_the_options_for_images(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"contains neither capture.json with views nor a take"):
        open_source(tmp_path)
