"""The errors of devices."""


class DriverError(RuntimeError):
    """Root of the drivers' errors."""


class DeviceLost(DriverError):
    """The device is gone (unplugged, powered off); opening it again may help."""


class SettingRefused(DriverError):
    """The device refuses a setting; the message names it, the value and the allowed values."""
