"""The window that shows the images: OpenGL by pyglet, its placement by Xlib."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyglet
from numpy.typing import NDArray
from pyglet import gl
from pyglet.libs.x11 import xlib as pyglet_xlib

from drivers.errors import DriverError, SettingRefused
from drivers.projector.messages import BYTES_LIMIT
from drivers.projector.x11.detected_output import DetectedOutput

pyglet.options.shadow_window = False


class _Window(pyglet.window.Window):  # type: ignore[misc]  # pyglet picks the class at run time
    """Closed neither by a key nor by a window manager; records when its pixels were lost."""

    exposed = False

    def on_expose(self) -> None:
        self.exposed = True

    def on_key_press(self, symbol: int, modifiers: int) -> None:
        """Ignore keys: escape would close a window of pyglet."""

    def on_close(self) -> None:
        """Ignore the request: only :meth:`close` closes it."""


class PatternWindow:
    """A hidden, borderless window of an output's size, invisible before :meth:`map`.

    Images are copied from textures by glBlitFramebuffer with GL_NEAREST: no shader, no blending, no dithering, no
    sRGB conversion and no multisampling changes them.

    Args:
        display: X display; output: to place it on.

    Raises:
        DriverError: no OpenGL 3.3. SettingRefused: no 8-bit red, green and blue.
    """

    def __init__(self, display: str, output: DetectedOutput) -> None:
        self.width, self.height = output.size
        config = gl.Config(
            double_buffer=True,
            major_version=3,
            minor_version=3,
            red_size=8,
            green_size=8,
            blue_size=8,
            alpha_size=0,
            depth_size=0,
            stencil_size=0,
            sample_buffers=0,
            samples=0,
        )
        try:
            self._window = _Window(
                self.width,
                self.height,
                display=pyglet.display.Display(display),  # type: ignore[attr-defined]  # as documented
                style=pyglet.window.Window.WINDOW_STYLE_BORDERLESS,
                caption="fringed projector",
                visible=False,
                vsync=True,
                config=config,
            )
        except (pyglet.window.NoSuchConfigException, gl.ContextException) as error:
            raise DriverError(f"X display {display}: no OpenGL 3.3 with 8-bit colours ({error})") from None
        self._window.set_mouse_platform_visible(False)
        self._sync()
        sizes = [getattr(self._window.context.config, f"{color}_size") for color in ("red", "green", "blue")]
        if sizes != [8, 8, 8]:
            raise SettingRefused(f"X display {display} draws {sizes} bits of red, green and blue, 8 each are needed")
        self._prepare()
        self._framebuffers: list[tuple[Any, Any]] = []

    @property
    def ids(self) -> tuple[int, int]:
        """X ids of the outer window and of the inner one that OpenGL draws to."""
        return int(self._window._window), int(self._window._view)

    def fileno(self) -> int:
        """Descriptor to poll for events of the window."""
        return int(self._window.display.fileno())

    def take_events(self) -> bool:
        """Handle events; return whether the pixels were lost and must be drawn again."""
        self._window.dispatch_events()
        lost, self._window.exposed = self._window.exposed, False
        return lost

    def map(self) -> None:
        """Show the window."""
        self._window.set_visible(True)
        self._sync()

    def load(self, images: NDArray[np.uint8]) -> str:
        """Replace the images in the graphics card by these, (N, H, W, 3), and draw the first one off screen.

        Returns:
            The problem of the pixels that OpenGL drew, empty when they equal the image, byte for byte.

        Raises:
            SettingRefused: images of another size than the window.
        """
        if images.shape[1:] != (self.height, self.width, 3) or images.nbytes > BYTES_LIMIT:
            raise SettingRefused(f"images {images.shape} do not fit, expected {self.height, self.width, 3}")
        self._window.switch_to()
        self._drop()
        self._framebuffers = [self._upload(image) for image in images]
        self.draw(0)
        drawn = self._read_back()
        wrong = int(np.count_nonzero((drawn != images[0]).any(axis=2)))
        return f"OpenGL drew {wrong} of {self.width * self.height} pixels with wrong values" if wrong else ""

    def draw(self, number: int | None) -> None:
        """Draw a loaded image (None = black) into the back buffer."""
        self._window.switch_to()
        gl.glBindFramebuffer(gl.GL_DRAW_FRAMEBUFFER, 0)
        if number is None:
            gl.glClearColor(0.0, 0.0, 0.0, 1.0)
            gl.glClear(gl.GL_COLOR_BUFFER_BIT)
            return
        gl.glBindFramebuffer(gl.GL_READ_FRAMEBUFFER, self._framebuffers[number][1])
        # The image's first row is its top; OpenGL counts from the bottom.
        rectangles = 0, 0, self.width, self.height, 0, self.height, self.width, 0
        gl.glBlitFramebuffer(*rectangles, gl.GL_COLOR_BUFFER_BIT, gl.GL_NEAREST)

    def flip(self) -> None:
        """Swap the buffers and wait until the graphics card has done so."""
        self._window.flip()
        gl.glFinish()
        self._sync()

    def close(self) -> None:
        """Close the window."""
        self._window.switch_to()
        self._drop()
        self._window.close()

    def _prepare(self) -> None:
        self._window.switch_to()
        for feature in (gl.GL_DITHER, gl.GL_BLEND, gl.GL_FRAMEBUFFER_SRGB, gl.GL_MULTISAMPLE, gl.GL_SCISSOR_TEST):
            gl.glDisable(feature)
        gl.glPixelStorei(gl.GL_UNPACK_ALIGNMENT, 1)
        gl.glPixelStorei(gl.GL_PACK_ALIGNMENT, 1)
        gl.glColorMask(True, True, True, True)

    def _upload(self, image: NDArray[np.uint8]) -> tuple[Any, Any]:
        texture, framebuffer = gl.GLuint(), gl.GLuint()
        gl.glGenTextures(1, texture)
        gl.glBindTexture(gl.GL_TEXTURE_2D, texture)
        size, data = (self.width, self.height), np.ascontiguousarray(image)
        pixels = gl.GL_RGB, gl.GL_UNSIGNED_BYTE, data.ctypes.data
        gl.glTexImage2D(gl.GL_TEXTURE_2D, 0, gl.GL_RGB8, *size, 0, *pixels)
        for side in (gl.GL_TEXTURE_MIN_FILTER, gl.GL_TEXTURE_MAG_FILTER):
            gl.glTexParameteri(gl.GL_TEXTURE_2D, side, gl.GL_NEAREST)
        gl.glGenFramebuffers(1, framebuffer)
        gl.glBindFramebuffer(gl.GL_READ_FRAMEBUFFER, framebuffer)
        gl.glFramebufferTexture2D(gl.GL_READ_FRAMEBUFFER, gl.GL_COLOR_ATTACHMENT0, gl.GL_TEXTURE_2D, texture, 0)
        if gl.glCheckFramebufferStatus(gl.GL_READ_FRAMEBUFFER) != gl.GL_FRAMEBUFFER_COMPLETE:
            raise DriverError(f"the graphics driver takes no texture of {self.width}x{self.height} pixels")
        return texture, framebuffer

    def _read_back(self) -> NDArray[np.uint8]:
        """Return the back buffer, (H, W, 3)."""
        drawn = np.empty((self.height, self.width, 3), np.uint8)
        gl.glBindFramebuffer(gl.GL_READ_FRAMEBUFFER, 0)
        gl.glReadBuffer(gl.GL_BACK)
        gl.glReadPixels(0, 0, self.width, self.height, gl.GL_RGB, gl.GL_UNSIGNED_BYTE, drawn.ctypes.data)
        return drawn[::-1]

    def _drop(self) -> None:
        for texture, framebuffer in self._framebuffers:
            gl.glDeleteFramebuffers(1, framebuffer)
            gl.glDeleteTextures(1, texture)
        self._framebuffers = []

    def _sync(self) -> None:
        pyglet_xlib.XSync(self._window._x_display, False)
