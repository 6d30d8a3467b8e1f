"""Compilation of the renderer's functions: without ``fastmath``, so that images are the same on every processor."""

from __future__ import annotations

import numba

from pipeline.common.jit import LINKED

compiled = numba.njit(cache=True, nogil=True)
inline = numba.njit(nogil=True, forceinline=True, **LINKED)
"""For functions that only compiled ones call. Arrays without owners (:func:`pipeline.common.parallel_for.unowned`) have
no references to count: LLVM removes the counting where it copies a function into its caller."""
