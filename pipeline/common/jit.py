"""Compilation of kernels, and the projection that several of them share.

``fastmath`` without ``nnan``/``ninf``: NaN marks unknown values and the tests for it must survive. No
reductions across threads: every output element is computed by one thread in a fixed order, so results do not depend on
the number of threads.
"""

from __future__ import annotations

from typing import Any

import numba

from pipeline.common.linked_code import LinkedCompiler

_COUNTING: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"nsz", "arcp", "contract", "afn", "reassoc"},
}
_FLAGS = _COUNTING | {"_nrt": False}
LINKED: dict[str, Any] = {
    "cache": False,
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "pipeline_class": LinkedCompiler,
}
"""Options for functions that are never called from Python."""

serial = numba.njit(no_cfunc_wrapper=True, **_FLAGS)
"""For functions that allocate no array and call none that does. They do not count references to arrays, which takes two
atomic operations for every slice of a row."""
linked = numba.njit(**_FLAGS | LINKED)
"""The same for functions that only kernels call."""
ordered = numba.njit(**_FLAGS | LINKED | {"fastmath": _FLAGS["fastmath"] | {"nnan"}})
"""The same for code without NaN: minima become vector instructions."""
inline = numba.njit(forceinline=True, **_FLAGS | LINKED)
"""The same for functions that LLVM copies into the caller. numba's own ``inline="always"`` does that before type
inference, and compiles several times as long."""
allocating = numba.njit(no_cfunc_wrapper=True, **_COUNTING)
"""For functions that allocate arrays, or return one."""
allocating_linked = numba.njit(**_COUNTING | LINKED)
"""The same for functions that only kernels call."""


@serial
def project(device: Any, x: float, y: float, z: float) -> tuple[float, float]:
    """Pixel of a world point through the full model; ``device`` is :func:`pipeline.geometry.ray_tables.packed`."""
    cz = device[8] * x + device[9] * y + device[10] * z + device[11]
    inv = 1.0 / cz
    a = (device[0] * x + device[1] * y + device[2] * z + device[3]) * inv
    b = (device[4] * x + device[5] * y + device[6] * z + device[7]) * inv
    r2 = a * a + b * b
    radial = 1.0 + r2 * (device[17] + r2 * (device[18] + r2 * device[21]))
    xd = a * radial + 2.0 * device[19] * a * b + device[20] * (r2 + 2.0 * a * a)
    yd = b * radial + device[19] * (r2 + 2.0 * b * b) + 2.0 * device[20] * a * b
    return device[12] * xd + device[13] * yd + device[14], device[15] * yd + device[16]
