"""A screenshot of the web viewer in a headless browser."""

from __future__ import annotations

import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray

from daemon.apps.viewer.layout import CLOUD_HEIGHT, CLOUD_WIDTH
from daemon.common.errors import DaemonError
from daemon.common.files import write_atomically
from drivers.child_process import interpreter

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
WINDOW = {"width": 1400, "height": 900}

_VIEW = "import sys; from daemon.cli.entry import main; sys.argv[0] = 'fringed'; main()"
_RATE_HZ = "0.5"  # with software rendering on two processors 2 exceeded the time-out, 0.5 took 43 s
_TIMEOUT_S = 120.0
_POLL_S = 1.0
_FLAGS = (
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
)


@dataclass(frozen=True, slots=True)
class Paint:
    """The contents of an image: number of distinct colours, and the share of foreground pixels."""

    colors: int
    share: float

    @property
    def enough(self) -> bool:
        """Whether the image shows a cloud."""
        return self.colors >= 24 and self.share >= 0.02

    def similar(self, other: Paint) -> bool:
        """Whether two images have about the same share of foreground; the object may move."""
        return abs(self.share - other.share) <= 0.2 * max(self.share, other.share)


def browser_program() -> str | None:
    """The Chromium on the path."""
    return next((path for name in BROWSERS if (path := shutil.which(name))), None)


def save_screenshot(
    endpoint: str, file: Path, *, color: str = "depth", decimate: int = 2, timeout_s: float = _TIMEOUT_S
) -> None:
    """Show a stream in a browser and save an image when it shows the cloud.

    Raises:
        DaemonError: no browser, no playwright, or no cloud within ``timeout_s``.
    """
    program = browser_program()
    if program is None:
        raise DaemonError(f"no browser found on the path ({', '.join(BROWSERS)}); install chromium")
    options = ["--color", color, "--decimate", str(decimate), "--rate", _RATE_HZ]
    with _served(endpoint, options) as address, _page(program, address) as page:
        write_atomically(file, wait_for_paint(page.screenshot, timeout_s=timeout_s))


def wait_for_paint(
    screenshot: Callable[[], bytes],
    *,
    timeout_s: float,
    poll_s: float = _POLL_S,
    now_s: Callable[[], float] = time.monotonic,
) -> bytes:
    """Poll images (PNG) until two consecutive ones show a similar cloud; returns the last one.

    Raises:
        DaemonError: no cloud within ``timeout_s``.
    """
    deadline_s, before, last = now_s() + timeout_s, None, Paint(0, 0.0)
    while now_s() < deadline_s:
        image = screenshot()
        last = paint(image)
        if before is not None and last.enough and before.enough and last.similar(before):
            return image
        before = last
        time.sleep(poll_s)
    raise DaemonError(
        f"the viewer showed no cloud within {timeout_s:.0f} s ({last.colors} colours on {100 * last.share:.0f} % of "
        "the "
        "view); check with `fringed listen` that a daemon sends clouds"
    )


def paint(png: bytes) -> Paint:
    """The contents of the middle of the 3D view."""
    import cv2

    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        return Paint(0, 0.0)
    height, width = image.shape[:2]
    rows = slice(round(0.15 * height), round(0.9 * CLOUD_HEIGHT * height))
    columns = slice(round(0.05 * width), round(0.9 * CLOUD_WIDTH * width))
    return _count(image[rows, columns])


def _count(image: NDArray[Any]) -> Paint:
    coarse = image.astype(np.uint32) >> 3
    codes = (coarse[..., 0] << 10) | (coarse[..., 1] << 5) | coarse[..., 2]
    counts = np.bincount(codes.ravel(), minlength=1 << 15)
    return Paint(int((counts >= 4).sum()), float(1.0 - counts.max() / codes.size))


@contextmanager
def _served(endpoint: str, options: list[str]) -> Iterator[str]:
    """Run ``fringed view --web`` and yield its address."""
    command = [*interpreter(), "-c", _VIEW, "view", endpoint, "--web", "--web-port", "0", "--grpc-port", "0", *options]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE) as process:
        try:
            line = process.stdout.readline() if process.stdout is not None else b""
            if not line.startswith(b"http://"):
                raise DaemonError(f"fringed view --web {endpoint} did not start")
            yield line.decode().strip()
        finally:
            process.kill()


@contextmanager
def _page(program: str, address: str) -> Iterator[Any]:
    """Open the address in a browser that connects only to this machine."""
    try:
        from playwright.sync_api import Error, sync_playwright
    except ModuleNotFoundError:
        raise DaemonError("--screenshot requires the package playwright: pip install playwright") from None
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, headless=True, args=list(_FLAGS))
        try:
            page = browser.new_page(viewport=WINDOW)
            page.set_default_timeout(1000 * _TIMEOUT_S)
            page.route("**/*", _local_only)
            page.goto(address)
            yield page
        except Error as error:
            raise DaemonError(f"the browser {program} failed: {error.message}") from error
        finally:
            browser.close()


def _local_only(route: Any) -> None:
    """Block external requests: the viewer checks for updates and reports its use."""
    if urlsplit(route.request.url).hostname in ("127.0.0.1", "localhost", None):
        route.continue_()
    else:
        route.abort()
