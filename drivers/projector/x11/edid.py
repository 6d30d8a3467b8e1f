"""The name in an EDID block (VESA E-EDID 1.4, section 3.10.3.4)."""

from __future__ import annotations

HEADER = bytes([0, 255, 255, 255, 255, 255, 255, 0])
BLOCK_BYTES = 128
DESCRIPTORS = range(54, 126, 18)
MONITOR_NAME = b"\0\0\0\xfc\0"


def monitor_name(edid: bytes) -> str:
    """The monitor's name, or its maker and product number (``EPS 0A12``); empty if this is no EDID."""
    if len(edid) < BLOCK_BYTES or edid[:8] != HEADER:
        return ""
    for start in DESCRIPTORS:
        if edid[start : start + 5] == MONITOR_NAME:
            text = edid[start + 5 : start + 18].split(b"\n")[0]
            name = text.decode("cp437", errors="replace").strip()
            if name:
                return name
    word = int.from_bytes(edid[8:10], "big")
    maker = "".join(chr(64 + (word >> shift & 31)) for shift in (10, 5, 0))
    return f"{maker} {int.from_bytes(edid[10:12], 'little'):04X}"
