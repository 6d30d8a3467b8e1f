"""What can go wrong with a device, each with a name to catch."""


class DriverError(RuntimeError):
    """Root of the drivers' errors."""


class DeviceLost(DriverError):
    """The device is gone (unplugged, powered off); opening it again may help."""


class SettingRefused(DriverError):
    """The device does not take a setting; the message names it, the value and what the device allows."""
