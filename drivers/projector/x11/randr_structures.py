"""Structures and functions of libXrandr, for ctypes."""

from __future__ import annotations

import ctypes
from ctypes import POINTER, Structure, c_char_p, c_int, c_long, c_uint, c_ulong, c_ushort, c_void_p
from functools import cache
from typing import Any

from drivers.projector.x11.xlib import XID, load


class ModeInfo(Structure):
    """XRRModeInfo."""

    _fields_ = (
        ("id", XID),
        ("width", c_uint),
        ("height", c_uint),
        ("dot_clock", c_ulong),
        ("h_sync_start", c_uint),
        ("h_sync_end", c_uint),
        ("h_total", c_uint),
        ("h_skew", c_uint),
        ("v_sync_start", c_uint),
        ("v_sync_end", c_uint),
        ("v_total", c_uint),
        ("name", c_char_p),
        ("name_length", c_uint),
        ("flags", c_ulong),
    )


class ScreenResources(Structure):
    """XRRScreenResources."""

    _fields_ = (
        ("timestamp", c_ulong),
        ("config_timestamp", c_ulong),
        ("ncrtc", c_int),
        ("crtcs", POINTER(XID)),
        ("noutput", c_int),
        ("outputs", POINTER(XID)),
        ("nmode", c_int),
        ("modes", POINTER(ModeInfo)),
    )


class OutputInfo(Structure):
    """XRROutputInfo."""

    _fields_ = (
        ("timestamp", c_ulong),
        ("crtc", XID),
        ("name", c_void_p),
        ("name_length", c_int),
        ("mm_width", c_ulong),
        ("mm_height", c_ulong),
        ("connection", c_ushort),
        ("subpixel_order", c_ushort),
        ("ncrtc", c_int),
        ("crtcs", POINTER(XID)),
        ("nclone", c_int),
        ("clones", POINTER(XID)),
        ("nmode", c_int),
        ("npreferred", c_int),
        ("modes", POINTER(XID)),
    )


class CrtcInfo(Structure):
    """XRRCrtcInfo."""

    _fields_ = (
        ("timestamp", c_ulong),
        ("x", c_int),
        ("y", c_int),
        ("width", c_uint),
        ("height", c_uint),
        ("mode", XID),
        ("rotation", c_ushort),
        ("noutput", c_int),
        ("outputs", POINTER(XID)),
        ("rotations", c_ushort),
        ("npossible", c_int),
        ("possible", POINTER(XID)),
    )


class CrtcGamma(Structure):
    """XRRCrtcGamma."""

    _fields_ = (("size", c_int), ("red", POINTER(c_ushort)), ("green", POINTER(c_ushort)), ("blue", POINTER(c_ushort)))


class TransformAttributes(Structure):
    """XRRCrtcTransformAttributes; matrices of 16.16 fixed point numbers, row by row."""

    _fields_ = (
        ("pending", c_int * 9),
        ("pending_filter", c_char_p),
        ("pending_count", c_int),
        ("pending_parameters", c_void_p),
        ("current", c_int * 9),
        ("current_filter", c_char_p),
        ("current_count", c_int),
        ("current_parameters", c_void_p),
    )


IDENTITY = (1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 16)

SIGNATURES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "XRRQueryExtension": (c_int, (c_void_p, POINTER(c_int), POINTER(c_int))),
    "XRRQueryVersion": (c_int, (c_void_p, POINTER(c_int), POINTER(c_int))),
    "XRRSelectInput": (None, (c_void_p, XID, c_int)),
    "XRRGetScreenResourcesCurrent": (POINTER(ScreenResources), (c_void_p, XID)),
    "XRRGetScreenResources": (POINTER(ScreenResources), (c_void_p, XID)),
    "XRRFreeScreenResources": (None, (POINTER(ScreenResources),)),
    "XRRGetOutputInfo": (POINTER(OutputInfo), (c_void_p, POINTER(ScreenResources), XID)),
    "XRRFreeOutputInfo": (None, (POINTER(OutputInfo),)),
    "XRRGetCrtcInfo": (POINTER(CrtcInfo), (c_void_p, POINTER(ScreenResources), XID)),
    "XRRFreeCrtcInfo": (None, (POINTER(CrtcInfo),)),
    "XRRGetOutputPrimary": (XID, (c_void_p, XID)),
    "XRRGetCrtcGammaSize": (c_int, (c_void_p, XID)),
    "XRRGetCrtcGamma": (POINTER(CrtcGamma), (c_void_p, XID)),
    "XRRAllocGamma": (POINTER(CrtcGamma), (c_int,)),
    "XRRSetCrtcGamma": (None, (c_void_p, XID, POINTER(CrtcGamma))),
    "XRRFreeGamma": (None, (POINTER(CrtcGamma),)),
    "XRRGetCrtcTransform": (c_int, (c_void_p, XID, POINTER(POINTER(TransformAttributes)))),
    "XRRListOutputProperties": (POINTER(XID), (c_void_p, XID, POINTER(c_int))),
    "XRRGetOutputProperty": (
        c_int,
        (
            *(c_void_p, XID, XID, c_long, c_long, c_int, c_int, XID),
            *(POINTER(XID), POINTER(c_int), POINTER(c_ulong), POINTER(c_ulong), POINTER(c_void_p)),
        ),
    ),
}


@cache
def xrandr() -> ctypes.CDLL:
    """The library libXrandr."""
    return load("libXrandr.so.2", SIGNATURES)
