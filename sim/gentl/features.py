"""The emulated cameras' features, by their names in the GenICam Standard Features Naming Convention (SFNC)."""

from __future__ import annotations

from sim.gentl.genapi import By, Description, Registers

REGISTERS = Registers("R", 0x40)
STREAM_REGISTERS = Registers("S", 0x40)

PIXEL_FORMATS = {
    "Mono8": 0x01080001,
    "Mono10": 0x01100003,
    "Mono12": 0x01100005,
    "Mono16": 0x01100007,
    "Mono10p": 0x010A0046,
    "Mono12p": 0x010C0047,
    "BayerGR8": 0x01080008,
    "BayerRG8": 0x01080009,
    "BayerGB8": 0x0108000A,
    "BayerBG8": 0x0108000B,
    "BayerGR10": 0x0110000C,
    "BayerRG10": 0x0110000D,
    "BayerGB10": 0x0110000E,
    "BayerBG10": 0x0110000F,
    "BayerGR12": 0x01100010,
    "BayerRG12": 0x01100011,
    "BayerGB12": 0x01100012,
    "BayerBG12": 0x01100013,
    "BayerBG10p": 0x010A0052,
    "BayerBG12p": 0x010C0053,
    "BayerGB10p": 0x010A0054,
    "BayerGB12p": 0x010C0055,
    "BayerGR10p": 0x010A0056,
    "BayerGR12p": 0x010C0057,
    "BayerRG10p": 0x010A0058,
    "BayerRG12p": 0x010C0059,
    "RGB8": 0x02180014,
}
"""Values of the Pixel Format Naming Convention (PFNC); bits 16 to 23 are the bits a pixel takes."""

TRIGGERS = {"AcquisitionStart": 0, "FrameBurstStart": 1, "FrameStart": 2}
LINES = {"Line0": 0, "Line1": 1, "Line2": 2}
SOURCES = {"Software": 0, "Line0": 1, "Line1": 2, "Line2": 3}
CHUNKS = {"Timestamp": 0, "FrameID": 1, "ExposureTime": 2, "TriggersMissed": 3}
BALANCE = {"Red": 0, "Green": 1, "Blue": 2}
AUTO = {"Off": 0, "Once": 1, "Continuous": 2}

OLD_NAMES = {
    "ExposureTime": "ExposureTimeAbs",
    "AcquisitionFrameRate": "AcquisitionFrameRateAbs",
    "TriggerDelay": "TriggerDelayAbs",
    "TimestampLatch": "GevTimestampControlLatch",
    "TimestampLatchValue": "GevTimestampValue",
}
"""Names of the features in GigE Vision cameras before the SFNC's second version."""
MODERN_ONLY = (
    "DeviceTemperature",
    "ChunkModeActive",
    "ChunkSelector",
    "ChunkEnable",
    *(f"Chunk{name}" for name in CHUNKS),
)
OLD_ONLY = ("GevTimestampTickFrequency",)
OLD_TICKS_PER_SECOND = 125_000_000


def describe(*, old: bool = False) -> Description:
    """The camera's features; ``old`` has the old names, a clock in ticks of 8 ns, no chunks and no temperature."""
    camera = Description(
        "FringedOldCam" if old else "FringedCam",
        REGISTERS,
        renamed=OLD_NAMES if old else {},
        left_out=MODERN_ONLY if old else OLD_ONLY,
    )
    image = _image_format, _analog, _chunks
    for part in (_device, *image, _acquisition, _triggers, _lines, _transport, _user_sets, _statistics):
        part(camera)
    return camera


def describe_stream() -> Description:
    """The data stream's features."""
    stream = Description("FringedStream", STREAM_REGISTERS, port="StreamPort")
    stream.category("StreamInformation")
    stream.text("StreamID")
    stream.choice("StreamBufferHandlingMode", {"OldestFirst": 1, "OldestFirstOverwrite": 2, "NewestOnly": 3})
    for name in "StreamAnnouncedBufferCount", "StreamDeliveredFrameCount", "StreamLostFrameCount":
        stream.integer(name, length=8)
    return stream


def _device(camera: Description) -> None:
    camera.category("DeviceControl")
    for name in "VendorName", "ModelName", "Version", "FirmwareVersion", "SerialNumber":
        camera.text(f"Device{name}")
    camera.text("DeviceUserID", writable=True)
    camera.number("DeviceTemperature", unit="C")
    camera.command("TimestampLatch")
    camera.integer("TimestampLatchValue", length=8)
    camera.integer("GevTimestampTickFrequency", length=8)


def _image_format(camera: Description) -> None:
    camera.category("ImageFormatControl")
    camera.integer("SensorWidth")
    camera.integer("SensorHeight")
    camera.formula("WidthLimit", "SENSOR - OFFSET", SENSOR="SensorWidthReg", OFFSET="OffsetXReg")
    camera.formula("HeightLimit", "SENSOR - OFFSET", SENSOR="SensorHeightReg", OFFSET="OffsetYReg")
    camera.formula("OffsetXLimit", "SENSOR - SIZE", SENSOR="SensorWidthReg", SIZE="WidthReg")
    camera.formula("OffsetYLimit", "SENSOR - SIZE", SENSOR="SensorHeightReg", SIZE="HeightReg")
    camera.integer("WidthMax")
    camera.integer("HeightMax")
    camera.integer("Width", 16, "WidthLimit", 4, locked=True)
    camera.integer("Height", 4, "HeightLimit", 2, locked=True)
    camera.integer("OffsetX", 0, "OffsetXLimit", 4)
    camera.integer("OffsetY", 0, "OffsetYLimit", 2)
    camera.integer("SensorFilter")
    for number, pattern in enumerate(("RG", "GR", "GB", "BG"), start=1):
        camera.formula(f"FilterIs{pattern}", f"FILTER = {number}", FILTER="SensorFilterReg")
    camera.formula("FilterIsColour", "FILTER > 0", FILTER="SensorFilterReg")
    only_if = {name: f"FilterIs{name[5:7]}" for name in PIXEL_FORMATS if name.startswith("Bayer")}
    camera.choice("PixelFormat", PIXEL_FORMATS, locked=True, only_if=only_if | {"RGB8": "FilterIsColour"})


def _acquisition(camera: Description) -> None:
    camera.category("AcquisitionControl")
    camera.choice("AcquisitionMode", {"Continuous": 0, "SingleFrame": 1, "MultiFrame": 2}, locked=True)
    camera.integer("AcquisitionFrameCount", 1, 65535, locked=True)
    camera.integer("AcquisitionBurstFrameCount", 1, 65535)
    camera.command("AcquisitionStart")
    camera.command("AcquisitionStop")
    camera.switch("AcquisitionFrameRateEnable")
    camera.number("AcquisitionFrameRate", 0.1, 1000, unit="Hz")
    camera.choice("ExposureMode", {"Timed": 0, "TriggerWidth": 1})
    camera.number("ExposureTime", 10, 10_000_000, unit="us")
    camera.choice("ExposureAuto", AUTO)


def _triggers(camera: Description) -> None:
    by = By("TriggerSelector", len(TRIGGERS))
    camera.choice("TriggerSelector", TRIGGERS)
    camera.choice("TriggerMode", {"Off": 0, "On": 1}, by=by)
    camera.command("TriggerSoftware", by=by)
    camera.choice("TriggerSource", SOURCES, by=by)
    camera.choice("TriggerActivation", {"RisingEdge": 0, "FallingEdge": 1, "AnyEdge": 2}, by=by)
    camera.number("TriggerDelay", 0, 1_000_000, unit="us", by=by)


def _analog(camera: Description) -> None:
    camera.category("AnalogControl")
    camera.number("Gain", 0, 24, unit="dB")
    camera.choice("GainAuto", AUTO)
    camera.choice("BalanceRatioSelector", BALANCE)
    camera.number("BalanceRatio", 0.25, 4, by=By("BalanceRatioSelector", len(BALANCE)))
    camera.choice("BalanceWhiteAuto", AUTO)
    camera.number("BlackLevel", 0, 32, unit="DN")
    camera.switch("GammaEnable")
    camera.number("Gamma", 0.25, 4)


def _lines(camera: Description) -> None:
    by = By("LineSelector", len(LINES))
    camera.category("DigitalIOControl")
    camera.choice("LineSelector", LINES)
    camera.choice("LineMode", {"Input": 0, "Output": 1}, by=by)
    camera.switch("LineInverter", by=by)
    camera.switch("LineStatus", by=by, read_only=True)
    camera.choice("LineSource", {"Off": 0, "ExposureActive": 1, "FrameTriggerWait": 2}, by=by)


def _chunks(camera: Description) -> None:
    camera.category("ChunkDataControl")
    camera.switch("ChunkModeActive", locked=True)
    camera.choice("ChunkSelector", CHUNKS)
    camera.switch("ChunkEnable", by=By("ChunkSelector", len(CHUNKS)), locked=True)
    for name, number in CHUNKS.items():
        camera.chunk(f"Chunk{name}", 0xA001 + number, number=name == "ExposureTime")


def _transport(camera: Description) -> None:
    camera.category("TransportLayerControl")
    camera.integer("PayloadSize", length=8)
    camera.integer("TLParamsLocked", 0, 1)


def _user_sets(camera: Description) -> None:
    camera.category("UserSetControl")
    camera.choice("UserSetSelector", {"Default": 0})
    camera.command("UserSetLoad", locked=True)


def _statistics(camera: Description) -> None:
    camera.category("EmulatorStatistics")
    for name in "TriggersMissed", "FramesSent":
        camera.integer(name, length=8)


CAMERA_XML = describe().xml()
OLD_CAMERA_XML = describe(old=True).xml()
STREAM_XML = describe_stream().xml()
