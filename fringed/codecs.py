"""Compression of message parts; the package is imported at the first compressed part."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringed.errors import CodecMissingError, WireError

CODECS = ("none", "blosc2")


def _blosc2(where: str) -> Any:
    try:
        import blosc2
    except ImportError:
        raise CodecMissingError(
            f"{where} is compressed with blosc2, which is not installed: pip install blosc2, or subscribe to cloud/full"
        ) from None
    return blosc2


def compress(array: NDArray[Any], codec: str) -> bytes:
    """Compress a C contiguous array to one blosc2 chunk (byte shuffle, LZ4)."""
    if codec != "blosc2":
        raise WireError(f"codec {codec!r} is not one of {', '.join(CODECS)}")
    blosc2 = _blosc2("the part")
    chunk: bytes = blosc2.compress(
        array.data.cast("B"),
        typesize=array.dtype.itemsize,
        clevel=1,
        filter=blosc2.Filter.SHUFFLE,
        codec=blosc2.Codec.LZ4,
    )
    return chunk


def decompress(raw: memoryview, size: int, where: str) -> NDArray[np.uint8]:
    """Decompress a blosc2 chunk to exactly ``size`` bytes; WireError for anything else."""
    blosc2 = _blosc2(where)
    if len(raw) < 32:  # the library reads its 32-byte chunk header without checking the length
        raise WireError(f"{where}: {len(raw)} bytes are not a blosc2 chunk")
    unpacked = int.from_bytes(raw[4:8], "little")
    packed = int.from_bytes(raw[12:16], "little")
    if packed != len(raw) or unpacked != size:
        raise WireError(
            f"{where}: blosc2 chunk of {packed} bytes for {unpacked}; {len(raw)} bytes came, the shape takes {size}"
        )
    out = np.empty(size, np.uint8)
    try:
        blosc2.decompress2(raw.tobytes(), dst=out)
    except Exception as error:  # the library raises several undocumented types
        raise WireError(f"{where}: blosc2 cannot decompress it: {error}") from None
    return out
