"""Compilation of functions that only other compiled functions call.

LLVM copies such a function into every caller, or links it to it, and generates the machine code there. numba generates
code of the function's own as well, for calls from Python, and keeps it in the cache on disk (what that takes:
docs/decisions/0023).

Uses internals of numba: it is pinned to one version.
"""

from __future__ import annotations

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler


class LinkedCompiler(Compiler):  # type: ignore[misc]
    """numba's ``pipeline_class`` of functions without a wrapper for Python, and without a cache."""

    def compile_extra(self, func: Any) -> Any:
        """Compile a function."""
        self.state.library = _LinkedLibrary(self.state.targetctx.codegen(), func.__qualname__)
        return super().compile_extra(func)


class _LinkedLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Optimised code in LLVM's representation, to be linked into others; no machine code."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:  # noqa: ARG002
        """0: no machine code defines the name."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> Any:
        """What receives the environment of the function, which has no machine code that reads it."""
        return _WithoutEnvironments


class _WithoutEnvironments:
    """In place of numba's code generator, which would write the environment's address into machine code."""

    @staticmethod
    def set_env(name: str, environment: Any) -> None:
        """Nothing: see :attr:`_LinkedLibrary.codegen`."""
