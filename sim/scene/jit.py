"""Compilation of the renderer's functions: without ``fastmath``, so that images are the same on every processor."""

from __future__ import annotations

import numba

compiled = numba.njit(cache=True, nogil=True)
inline = numba.njit(cache=True, nogil=True, forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""For functions that only compiled ones call. Arrays without owners (:func:`pipeline.common.parallel_for.unowned`) have
no references to count: LLVM removes the counting where it copies a function into its caller."""
