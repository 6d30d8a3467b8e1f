"""Operations that compiled kernels execute, and the memory that they touch, counted in a process of its own.

Operations: numba's optimised LLVM code gets an addition to a counter at the end of every block of instructions, after
vectorisation, which therefore is that of the kernels in use. Memory: the pages whose accessed bit the processor has set
between two readings of /proc/self/smaps.
"""

from __future__ import annotations

import ctypes
import mmap
import re
import statistics
from collections.abc import Callable
from pathlib import Path
from typing import Any

from llvmlite import binding
from numba.core.codegen import CPUCodeLibrary

from pipeline.common.parallel_for import ParallelFor

KINDS = ("flops", "others", "instructions")
"""Counters: float additions, multiplications, divisions and roots, by element, a fused one as two; integer operations
of up to 32 bits, comparisons, selections and conversions, by element; instructions, a vector's as one."""

_ADDRESS = 0x2000_0000_0000  # the same in every process, since it is part of cached code
_FIXED_NOREPLACE = 0x100000
_THP_DISABLE = 41
_TYPE = r"(?:<(\d+) x )?(\w+)"
_FLAGS = r"(?:(?:reassoc|nnan|ninf|nsz|arcp|contract|afn|fast|nuw|nsw|exact|disjoint|nneg|samesign) )*"
_FLOAT = re.compile(rf"= (?:fadd|fsub|fmul|fdiv|frem) {_FLAGS}{_TYPE}")
_OTHER = re.compile(
    rf"= (?:[if]cmp {_FLAGS}\w+|add|sub|mul|[su]div|[su]rem|shl|[la]shr|and|or|xor|trunc|[sz]ext|fptrunc|fpext|"
    rf"fpto[su]i|[su]itofp|fneg) {_FLAGS}{_TYPE}"
)
_SELECT = re.compile(rf"= select {_FLAGS}(?:<\d+ x )?i1>? [^,]+, {_TYPE}")
_CALL = re.compile(rf"call {_FLAGS}{_TYPE}>? @llvm\.(fma|fmuladd|sqrt|[us]?min|[us]?max|minnum|maxnum|minimum|maximum|"
                   r"fabs|abs|floor|ceil|trunc|rint|round|nearbyint|copysign)\b")  # fmt: skip
_END = re.compile(r"  (?:br|ret|switch|unreachable|indirectbr|resume)\b")
_NO_WORK = re.compile(r"  (?:\S+ = )?(?:phi|(?:tail )?call void @llvm\.(?:dbg|assume|lifetime|experimental))\b")


def counts_of(line: str) -> tuple[int, int, int]:
    """What an instruction of LLVM adds to the counters :data:`KINDS`."""
    if not line.startswith("  ") or _NO_WORK.match(line):
        return 0, 0, 0
    if (found := _FLOAT.search(line)) is not None:
        return int(found[1] or 1), 0, 1
    if (found := _CALL.search(line)) is not None:
        n, name = int(found[1] or 1), found[3]
        return (2 * n, 0, 1) if name in ("fma", "fmuladd") else (n, 0, 1) if name == "sqrt" else (0, n, 1)
    found = _OTHER.search(line) or _SELECT.search(line)
    # Scalars of 64 bits are addresses and the counters of loops.
    return (0, int(found[1] or 1), 1) if found is not None and (found[1] or found[2] != "i64") else (0, 0, 1)


def instrumented(assembly: str) -> str:
    """LLVM assembly whose blocks count what they execute."""
    lines: list[str] = []
    sums, number = [0] * len(KINDS), 0
    for line in assembly.splitlines():
        if _END.match(line):
            for k, total in enumerate(sums):
                if total:
                    place = f"ptr inttoptr (i64 {_ADDRESS + 8 * k} to ptr)"
                    lines.append(f"  %counted.{number} = atomicrmw add {place}, i64 {total} monotonic")
                    number += 1
            sums = [0] * len(KINDS)
        else:
            sums = [a + b for a, b in zip(sums, counts_of(line), strict=True)]
        lines.append(line)
    return "\n".join(lines)


def count_operations() -> Callable[[str], int]:
    """Let all kernels that are compiled from now on count; the result gives the value of a counter of :data:`KINDS`."""
    libc = ctypes.CDLL(None, use_errno=True)
    libc.mmap.restype = ctypes.c_void_p
    libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_int]
    flags = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | _FIXED_NOREPLACE
    if libc.mmap(_ADDRESS, mmap.PAGESIZE, mmap.PROT_READ | mmap.PROT_WRITE, flags, -1, 0) != _ADDRESS:
        raise OSError(ctypes.get_errno(), "the page of the counters cannot be mapped")
    counters = (ctypes.c_int64 * len(KINDS)).from_address(_ADDRESS)
    finalize = CPUCodeLibrary._finalize_final_module

    def counted(library: Any) -> None:
        # Other kernels are linked with the plain module: a counter inside would prevent their vectorisation.
        plain = library._final_module
        library._final_module = binding.parse_assembly(instrumented(str(plain)))
        library._final_module.name = plain.name
        try:
            finalize(library)
        finally:
            library._final_module = plain

    CPUCodeLibrary._finalize_final_module = counted
    return lambda kind: int(counters[KINDS.index(kind)])


IN_HEAP = {"MALLOC_ARENA_MAX": "1", "MALLOC_MMAP_MAX_": "0", "MALLOC_TRIM_THRESHOLD_": str(1 << 30)}
"""Variables for the C library of a process whose memory is counted."""


class TouchedMemory:
    """Bytes of the heap's pages that are read or written, each once between two readings.

    All arrays must lie in the heap (see :data:`IN_HEAP`). What the process touches by itself during a reading is
    measured first and taken off.

    Args:
        by_loop: read after every parallel loop, so that a page that two loops touch counts twice.
    """

    def __init__(self, *, by_loop: bool) -> None:
        ctypes.CDLL(None).prctl(_THP_DISABLE, 1, 0, 0, 0)
        self._idle = 0
        self._idle, self._total = round(statistics.median([self._read() for _ in range(9)][2:])), 0
        run, note = ParallelFor.__call__, self.total

        def call(loop: ParallelFor, count: int, *arguments: Any) -> None:
            run(loop, count, *arguments)
            note()

        if by_loop:
            ParallelFor.__call__ = call  # type: ignore[method-assign, assignment]

    def total(self) -> int:
        """Bytes so far."""
        self._total += self._read()
        return self._total

    def _read(self) -> int:
        """Bytes touched since the last reading."""
        touched = 0
        with Path("/proc/self/smaps").open() as lines:
            for line in lines:
                if line.endswith("[heap]\n"):  # one of several parts
                    touched += int(next(row for row in lines if row.startswith("Referenced:")).split()[1])
        Path("/proc/self/clear_refs").write_text("1")
        return max(0, 1024 * touched - self._idle)
