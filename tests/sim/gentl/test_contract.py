"""The producer keeps to GenTL whatever a program does: wrong handles, small buffers, wrong order of calls."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Iterator
from ctypes import byref, c_bool, c_char_p, c_int32, c_size_t, c_uint32, c_uint64, c_void_p, create_string_buffer
from pathlib import Path

import pytest

from sim.gentl.cable import Cable

Cables = Callable[..., Cable]
SUCCESS, NOT_IMPLEMENTED, IN_USE, INVALID_HANDLE = 0, -1003, -1004, -1006
INVALID_ID, NO_TIME, ABORT, NOT_AVAILABLE = -1007, -1011, -1012, -1014
INVALID_ADDRESS, TOO_SMALL, INVALID_INDEX, INVALID_VALUE = -1015, -1016, -1017, -1019
NEW_BUFFER, DISCARD_ALL = 1, 4
WITHOUT_HANDLE = {"GCInitLib", "GCCloseLib", "GCGetInfo", "GCGetLastError", "TLOpen"}
LATER = {
    "DSAnnounceCompositeBuffer",
    "DSGetBufferInfoStacked",
    "DSGetBufferPartInfoStacked",
    "DSGetBufferSegmentInfo",
    "DSGetFlowInfo",
    "DSGetNumBufferSegments",
    "DSGetNumFlows",
}
FUNCTIONS = """
    GCInitLib GCCloseLib GCGetLastError GCGetInfo TLOpen TLClose TLGetInfo TLGetNumInterfaces TLGetInterfaceID
    TLGetInterfaceInfo TLOpenInterface TLUpdateInterfaceList IFClose IFGetInfo IFGetNumDevices IFGetDeviceID
    IFUpdateDeviceList IFGetDeviceInfo IFOpenDevice IFGetParentTL DevGetPort DevGetNumDataStreams DevGetDataStreamID
    DevOpenDataStream DevGetInfo DevClose DevGetParentIF GCReadPort GCWritePort GCReadPortStacked GCWritePortStacked
    GCGetPortURL GCGetNumPortURLs GCGetPortURLInfo GCGetPortInfo DSAnnounceBuffer DSAllocAndAnnounceBuffer
    DSRevokeBuffer DSQueueBuffer DSFlushQueue DSStartAcquisition DSStopAcquisition DSGetInfo DSGetBufferID DSClose
    DSGetParentDev DSGetBufferInfo DSGetBufferChunkData DSGetNumBufferParts DSGetBufferPartInfo GCRegisterEvent
    GCUnregisterEvent EventGetData EventGetDataInfo EventGetInfo EventFlush EventKill
""".split()  # noqa: SIM905


class Library:
    """The producer's functions as they are, and handles down to the stream of the first camera."""

    def __init__(self, producer: Path) -> None:
        self.c = ctypes.CDLL(str(producer))
        self.system, self.interface, self.device = c_void_p(), c_void_p(), c_void_p()
        self.port, self.stream, self.event = c_void_p(), c_void_p(), c_void_p()

    def ok(self, name: str, *arguments: object) -> None:
        """A call that has to succeed."""
        assert getattr(self.c, name)(*arguments) == SUCCESS, self.problem()

    def problem(self) -> str:
        """The text of the last error."""
        text, size = create_string_buffer(256), c_size_t(256)
        assert self.c.GCGetLastError(None, text, byref(size)) == SUCCESS
        return text.value.decode()

    def open(self) -> None:
        """Down to the stream, with its event."""
        self.ok("GCInitLib")
        self.ok("TLOpen", byref(self.system))
        self.ok("TLOpenInterface", self.system, b"FringedInterface", byref(self.interface))
        self.ok("IFUpdateDeviceList", self.interface, None, c_uint64(0))
        self.ok("IFOpenDevice", self.interface, b"FringedCam_0", c_int32(3), byref(self.device))
        self.ok("DevGetPort", self.device, byref(self.port))
        self.ok("DevOpenDataStream", self.device, b"Stream0", byref(self.stream))
        self.ok("GCRegisterEvent", self.stream, NEW_BUFFER, byref(self.event))


@pytest.fixture
def library(producer: Path, cable: Cables) -> Iterator[Library]:
    """The producer with camera 0 open."""
    cable()
    opened = Library(producer)
    opened.open()
    yield opened
    opened.c.GCCloseLib()


def test_every_function_is_there_and_refuses_what_is_no_handle_of_its_kind(library: Library) -> None:
    alien = create_string_buffer(4096)
    for name in FUNCTIONS:
        function = getattr(library.c, name)
        if name in WITHOUT_HANDLE:
            continue
        for handle in None, alien, library.interface if name[:2] != "IF" else library.system:
            if name.startswith("GC") and handle is not None:
                continue  # ports of other modules are handles, though without registers
            rest = [byref(create_string_buffer(64)) for _ in range(6)]
            assert function(handle, *rest) == INVALID_HANDLE, name
    for name in LATER:
        assert getattr(library.c, name)() == NOT_IMPLEMENTED


def test_handles_are_dead_once_closed(library: Library) -> None:
    library.ok("DSClose", library.stream)
    assert library.c.DSGetInfo(library.stream, 0, None, None, byref(c_size_t())) == INVALID_HANDLE
    library.ok("DevClose", library.device)
    assert library.c.DevGetPort(library.device, byref(c_void_p())) == INVALID_HANDLE
    assert library.c.GCReadPort(library.port, c_uint64(0x40), create_string_buffer(4), byref(c_size_t(4))) < 0
    library.ok("IFOpenDevice", library.interface, b"FringedCam_0", c_int32(3), byref(library.device))


def test_what_is_open_is_not_opened_twice(library: Library) -> None:
    out = c_void_p()
    assert library.c.GCInitLib() == IN_USE
    assert library.c.TLOpen(byref(out)) == IN_USE
    assert library.c.TLOpenInterface(library.system, b"FringedInterface", byref(out)) == IN_USE
    assert library.c.IFOpenDevice(library.interface, b"FringedCam_0", c_int32(3), byref(out)) == IN_USE
    assert library.c.DevOpenDataStream(library.device, b"Stream0", byref(out)) == IN_USE
    assert library.c.GCRegisterEvent(library.stream, NEW_BUFFER, byref(out)) == IN_USE


def test_unknown_names_are_rejected(library: Library) -> None:
    out, size = c_void_p(), c_size_t()
    assert library.c.IFOpenDevice(library.interface, b"FringedCam_5", c_int32(3), byref(out)) == INVALID_ID
    assert "FringedCam_5" in library.problem()
    assert library.c.IFGetDeviceID(library.interface, c_uint32(1), None, byref(size)) == INVALID_INDEX
    assert library.c.DevOpenDataStream(library.device, b"Stream1", byref(out)) == INVALID_ID
    assert library.c.GCGetNumPortURLs(library.system, byref(c_uint32())) == NOT_AVAILABLE
    assert library.c.DSGetInfo(library.stream, 99, None, None, byref(size)) == NOT_AVAILABLE


def test_sizes_are_returned_first_and_too_small_buffers_are_not_written(library: Library) -> None:
    size = c_size_t()
    library.ok("IFGetDeviceID", library.interface, c_uint32(0), None, byref(size))
    assert size.value == len(b"FringedCam_0") + 1
    room, short = create_string_buffer(b"?" * 20), c_size_t(size.value - 1)
    assert library.c.IFGetDeviceID(library.interface, c_uint32(0), room, byref(short)) == TOO_SMALL
    assert room.value == b"?" * 20
    library.ok("IFGetDeviceID", library.interface, c_uint32(0), room, byref(size))
    assert room.value == b"FringedCam_0"


@pytest.mark.parametrize(("address", "size"), [(0xFFFF, 4), (0x3F, 100_000), (2**64 - 4, 4), (0x200000, 1)])
def test_registers_that_do_not_exist_are_refused(library: Library, address: int, size: int) -> None:
    room = create_string_buffer(size)
    for call in library.c.GCReadPort, library.c.GCWritePort:
        for port in library.port, library.stream:
            assert call(port, c_uint64(address), room, byref(c_size_t(size))) == INVALID_ADDRESS


def test_a_wait_ends_when_the_time_is_over_or_the_event_is_killed(library: Library) -> None:
    data, results = create_string_buffer(16), []
    assert library.c.EventGetData(library.event, data, byref(c_size_t(16)), c_uint64(1)) == NO_TIME

    def wait() -> None:
        results.append(library.c.EventGetData(library.event, data, byref(c_size_t(16)), c_uint64(2**64 - 1)))

    waiting = threading.Thread(target=wait)
    waiting.start()
    library.ok("EventKill", library.event)
    waiting.join(20)
    assert results == [ABORT]


def test_buffers_are_announced_queued_and_revoked(library: Library) -> None:
    memory, handle, base = create_string_buffer(4096), c_void_p(), c_void_p()
    library.ok("DSAnnounceBuffer", library.stream, memory, c_size_t(4096), c_char_p(b"mine"), byref(handle))
    library.ok("DSQueueBuffer", library.stream, handle)
    assert library.c.DSQueueBuffer(library.stream, handle) == IN_USE
    queued, size = c_bool(), c_size_t(1)
    library.ok("DSGetBufferInfo", library.stream, handle, 5, None, byref(queued), byref(size))
    assert queued.value
    library.ok("DSFlushQueue", library.stream, DISCARD_ALL)
    library.ok("DSRevokeBuffer", library.stream, handle, byref(base), None)
    assert base.value == ctypes.addressof(memory)
    for call in library.c.DSQueueBuffer, library.c.DSRevokeBuffer:
        assert call(library.stream, handle, None, None) == INVALID_HANDLE


def test_a_number_of_buffers_without_end_is_refused(library: Library) -> None:
    handle = c_void_p()
    for _ in range(512):
        library.ok("DSAllocAndAnnounceBuffer", library.stream, c_size_t(16), None, byref(handle))
    assert library.c.DSAllocAndAnnounceBuffer(library.stream, c_size_t(16), None, byref(handle)) < 0
    assert "512" in library.problem()
