"""One open camera through harvesters, with the ways around what harvesters and producers do unexpectedly.

* Waiting in ``fetch`` holds Python's lock (harvesters issue 508) and its time-outs restart with each incomplete
  image, so :meth:`Connection.fetch` asks once and returns.
* ``start(run_as_thread=True)`` ignores time-outs; it is never used.
* An incomplete image is queued again silently; only a callback tells of it.
* Finalizers that refer to what they are to finalize keep every camera ever opened in memory (about 0.4 MB each).
* After a camera vanished ``destroy`` raises half-way and leaves the device open; the second call finishes.
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

from genicam import gentl
from harvesters.core import Callback, Harvester, ImageAcquirer, ParameterKey, ParameterSet

from drivers.errors import DeviceLost, DriverError
from drivers.genicam.features import GENICAM_ERRORS, Features, losses
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
            unless the process has nothing else to do.

    Raises:
        DeviceLost: it is not there, or in use. DriverError: several cameras fit, or no producer loads.
    """

    def __init__(self, producers: Sequence[Path], options: Options, *, wait_ms: int = 0) -> None:
        _find_temporary_directory()
        self._incomplete = _Incomplete()
        self._harvester = Harvester()
        self._acquirer: Any = None
        self._chunks: Any = None
        try:
            with losses("looking for it"), _signals_kept():
                for producer in producers:
                    self._harvester.add_file(str(producer))
                self._harvester.update()
                number, self.found = _choose(self._harvester.device_info_list, options, producers)
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
            raise DriverError(f"{self.found.model} {self.found.serial} has no data stream")
        self.stream = Features(streams[0].node_map)
        self._port = self._acquirer.remote_device.port

    @property
    def incomplete(self) -> int:
        """Images that arrived in part and were thrown away."""
        return self._incomplete.count

    def underruns(self) -> int:
        """Images that the transport had no buffer for, as its producer counts them; 0 if it does not."""
        with suppress(*GENICAM_ERRORS):
            return int(self._acquirer.data_streams[0].num_underrun)
        return 0

    def start(self) -> None:
        """Begin to accept triggers."""
        with losses("starting"):
            self._acquirer.start()

    def fetch(self) -> Any:
        """The next complete image (a GenTL buffer that must be given to :meth:`requeue`), None if none is there.

        Raises:
            DeviceLost: the producer says so; most only fall silent (see :meth:`probe`).
        """
        try:
            found = self._acquirer.try_fetch(timeout=_ONE_POLL_S, is_raw=True)
        except gentl.GenericException as error:
            raise DeviceLost(f"the camera is gone (waiting for an image): {error}") from error
        if isinstance(found, list):
            first, *others = found
            for other in others:
                if other is not None:
                    self.requeue(other)
            return first
        return found

    def requeue(self, buffer: Any) -> None:
        """Let the transport fill the buffer again."""
        with losses("returning a buffer"):
            buffer.parent.queue_buffer(buffer)

    def probe(self) -> None:
        """Ask the camera for anything at all; DeviceLost when it does not answer.

        A pulled plug and a missing trigger look the same to ``fetch``; only a register tells.
        """
        try:
            self._port.read(0, 4)
        except (gentl.InvalidAddressException, gentl.NotImplementedException, gentl.InvalidParameterException):
            return
        except gentl.GenericException as error:
            raise DeviceLost(f"the camera is gone (asking whether it is there): {error}") from error

    def stop(self) -> None:
        """Stop accepting triggers; images not fetched are dropped."""
        with losses("stopping"):
            self._acquirer.stop()

    def close(self) -> None:
        """Let go of the camera, whatever state it is in; never raises."""
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
                f"{self.found.model} {self.found.serial} is in use by another program; end that one first ({error})"
            ) from error
        except GENICAM_ERRORS as error:
            raise DeviceLost(f"{self.found.model} {self.found.serial} cannot be opened: {error}") from error


def _choose(devices: Sequence[Any], options: Options, producers: Sequence[Path]) -> tuple[int, DetectedCamera]:
    """The one camera that is meant."""
    there = [describe(device) for device in devices]
    wanted = {"serial": options.serial, "model": options.model, "user_name": options.user_name}
    asked = {key: value for key, value in wanted.items() if value is not None}
    fits = [i for i, found in enumerate(there) if all(getattr(found, key) == value for key, value in asked.items())]
    if len(fits) == 1:
        return fits[0], there[fits[0]]
    named = ", ".join(f"{key} {value!r}" for key, value in asked.items())
    names = "; ".join(f"{found.model} serial {found.serial!r} user_name {found.user_name!r}" for found in there)
    seen = f"there are: {names}" if there else "there is none at all; check its power, cable and the vendor's producer"
    through = ", ".join(str(path) for path in producers)
    if not fits:
        raise DeviceLost(f"no camera with {named} through {through}; {seen}")
    raise DriverError(f"{len(fits)} cameras with {named} through {through}; name one of them by its serial; {seen}")


@contextmanager
def _signals_kept() -> Iterator[None]:
    """Put the SIGINT handler back; harvesters installs its own when it runs in the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGINT)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _find_temporary_directory() -> None:
    """Camera descriptions are unpacked into one; without a usable one nothing works."""
    try:
        tempfile.gettempdir()
    except FileNotFoundError:
        for place in (*(os.environ.get(name, "").split(":")[0] for name in _TEMPORARY), "/dev/shm"):  # noqa: S108
            if place and os.access(place, os.W_OK):
                tempfile.tempdir = place
                return
        raise DriverError(
            "no directory for temporary files; under systemd set PrivateTmp=yes or RuntimeDirectory="
        ) from None
