"""One open camera through harvesters, with work-arounds for unexpected behaviour of harvesters and producers.

* Waiting in ``fetch`` holds Python's lock (harvesters issue 508) and its time-outs restart with each incomplete
  image, so :meth:`Connection.fetch` polls once and returns.
* ``start(run_as_thread=True)`` ignores time-outs; it is never used.
* An incomplete image is queued again silently; only a callback reports it.
* Finalizers that refer to their own objects keep every camera ever opened in memory (about 0.4 MB each).
* After a camera was lost ``destroy`` raises half-way and leaves the device open; the second call finishes.
* Creating an acquirer replaces the SIGINT handler; it is put back.
* Descriptions are written to a temporary directory that may not exist under a hardened service.
* ``Harvester.update`` closes every camera of the process, which is one reason why each has a process of its own.
"""

from __future__ import annotations

import os
import signal
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import msgspec
from genicam import gentl
from harvesters.core import Callback, Harvester, ImageAcquirer, ParameterKey, ParameterSet

from drivers.errors import DeviceLost, DriverError
from drivers.genicam.features import GENICAM_ERRORS, Features, device_lost_errors
from drivers.genicam.listing import DetectedCamera, describe
from drivers.genicam.options import Options

_ONE_POLL_S = 1e-6
_IN_USE = (gentl.ResourceInUseException, gentl.AccessDeniedException, gentl.BusyException)
_TEMPORARY = ("RUNTIME_DIRECTORY", "XDG_RUNTIME_DIR")


class _Incomplete(Callback):  # type: ignore[misc]
    def __init__(self) -> None:
        self.count = 0

    def emit(self, context: object = None) -> None:  # noqa: ARG002 - harvesters' signature
        self.count += 1


class Connection:
    """An open camera.

    Args:
        producers: .cti files. wait_ms: how long one :meth:`fetch` may wait in the producer, holding Python's lock; 0
            unless the process has no other tasks.

    Raises:
        DeviceLost: it does not exist, or is in use. DriverError: several cameras match, or no producer loads.
    """

    def __init__(self, producers: Sequence[Path], options: Options, *, wait_ms: int = 0) -> None:
        _find_temporary_directory()
        self._incomplete = _Incomplete()
        self._harvester = Harvester()
        self._acquirer: Any = None
        self._chunks: Any = None
        try:
            with device_lost_errors("listing cameras"), _signals_kept():
                for producer in producers:
                    self._harvester.add_file(str(producer))
                self._harvester.update()
                number, self.device = _choose(self._harvester.device_info_list, options, producers)
                self._acquirer = self._create(number, wait_ms)
        except BaseException:
            self.close()
            raise
        self._acquirer.add_callback(ImageAcquirer.Events.INCOMPLETE_BUFFER, self._incomplete)
        self._acquirer.num_buffers = options.buffers
        self._chunks = getattr(self._acquirer, "_chunk_adapter", None)  # private to harvesters, not in every release
        self.camera = Features(self._acquirer.remote_device.node_map)
        streams = self._acquirer.data_streams
        if not streams:
            self.close()
            raise DriverError(f"{self.device.model} {self.device.serial} has no data stream")
        self.stream = Features(streams[0].node_map)
        self._port = self._acquirer.remote_device.port

    @property
    def incomplete(self) -> int:
        """Images that arrived in part and were discarded."""
        return self._incomplete.count

    def underruns(self) -> int:
        """Return the images that the transport had no buffer for, as counted by its producer; 0 if it does not."""
        with suppress(*GENICAM_ERRORS):
            return int(self._acquirer.data_streams[0].num_underrun)
        return 0

    def start(self) -> None:
        """Begin to accept triggers."""
        with device_lost_errors("starting"):
            self._acquirer.start()

    def fetch(self) -> Any:
        """Return the next complete image (a GenTL buffer for :meth:`requeue`), None if there is none.

        Raises:
            DeviceLost: reported by the producer; most only fall silent (see :meth:`probe`).
        """
        try:
            fetched = self._acquirer.try_fetch(timeout=_ONE_POLL_S, is_raw=True)
        except gentl.GenericException as error:
            raise DeviceLost(f"the camera is gone (waiting for an image): {error}") from error
        if isinstance(fetched, list):
            first, *others = fetched
            for other in others:
                if other is not None:
                    self.requeue(other)
            return first
        return fetched

    def requeue(self, buffer: Any) -> None:
        """Return a buffer to the transport."""
        with device_lost_errors("returning a buffer"):
            buffer.parent.queue_buffer(buffer)

    def probe(self) -> None:
        """Read a register of the camera; DeviceLost when it does not answer.

        ``fetch`` cannot distinguish a lost connection from a missing trigger.
        """
        try:
            self._port.read(0, 4)
        except (gentl.InvalidAddressException, gentl.NotImplementedException, gentl.InvalidParameterException):
            return
        except gentl.GenericException as error:
            raise DeviceLost(f"the camera is gone (checking the connection): {error}") from error

    def stop(self) -> None:
        """Stop accepting triggers; images not fetched are dropped."""
        with device_lost_errors("stopping"):
            self._acquirer.stop()

    def close(self) -> None:
        """Release the camera in any state; never raises."""
        if self._acquirer is not None:
            for _ in range(2):
                try:
                    self._acquirer.destroy()
                    break
                except GENICAM_ERRORS:
                    continue
        for _ in range(2):
            try:
                self._harvester.reset()
                break
            except GENICAM_ERRORS:
                continue
        for owner in (self._chunks, self._acquirer, self._harvester):
            # Finalizers of harvesters, private to it, hold bound methods, which keep their owners alive until the end.
            finalizer = getattr(owner, "_finalizer", None)
            if finalizer is not None:
                finalizer.detach()

    def _create(self, number: int, wait_ms: int) -> Any:
        config = ParameterSet({ParameterKey.TIMEOUT_PERIOD_ON_UPDATE_EVENT_DATA_CALL: wait_ms})
        try:
            return self._harvester.create(number, config=config)
        except _IN_USE as error:
            raise DeviceLost(
                f"{self.device.model} {self.device.serial} is in use by another program; end that one first ({error})"
            ) from error
        except GENICAM_ERRORS as error:
            raise DeviceLost(f"{self.device.model} {self.device.serial} cannot be opened: {error}") from error


def _choose(devices: Sequence[Any], options: Options, producers: Sequence[Path]) -> tuple[int, DetectedCamera]:
    """Return number and description of the one camera that matches the options."""
    cameras = [describe(device) for device in devices]
    options_of = {"serial": options.serial, "model": options.model, "user_name": options.user_name}
    selection = {key: value for key, value in options_of.items() if value is not None}
    matches = [i for i, camera in enumerate(cameras) if selection.items() <= msgspec.structs.asdict(camera).items()]
    if len(matches) == 1:
        return matches[0], cameras[matches[0]]
    selected = ", ".join(f"{key} {value!r}" for key, value in selection.items())
    names = "; ".join(f"{camera.model} serial {camera.serial!r} user_name {camera.user_name!r}" for camera in cameras)
    listed = f"there are: {names}" if cameras else "there is none; check its power, cable and the vendor's producer"
    through = ", ".join(str(path) for path in producers)
    if not matches:
        raise DeviceLost(f"no camera with {selected} through {through}; {listed}")
    raise DriverError(
        f"{len(matches)} cameras with {selected} through {through}; name one of them by its serial; {listed}"
    )


@contextmanager
def _signals_kept() -> Iterator[None]:
    """Restore the SIGINT handler; harvesters installs its own when it runs in the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGINT)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _find_temporary_directory() -> None:
    """Set a usable temporary directory: camera descriptions are unpacked there."""
    try:
        tempfile.gettempdir()
    except FileNotFoundError:
        for directory in (*(os.environ.get(name, "").split(":")[0] for name in _TEMPORARY), "/dev/shm"):  # noqa: S108
            if directory and os.access(directory, os.W_OK):
                tempfile.tempdir = directory
                return
        raise DriverError(
            "no directory for temporary files; under systemd set PrivateTmp=yes or RuntimeDirectory="
        ) from None
