"""What compiled kernels execute and touch is counted as it is."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from benchmarks.reconstruction.counted import IN_HEAP, counts_of, instrumented

ROWS, COLUMNS, PLANES_MB = 4, 203, 8

PROGRAM = f"""
import json, sys
import numpy as np
from benchmarks.reconstruction import counted, roofline

value = counted.count_operations()
x, p = np.full(({ROWS}, {COLUMNS}), 0.5, np.float32), np.linspace(0.1, 0.9, 17).astype(np.float32)
out = np.empty_like(x)
roofline.horner({ROWS}, x, p, out)
found = {{kind: value(kind) for kind in counted.KINDS}} | {{"passes": roofline.PASSES}}
a, b, c = (np.ones({PLANES_MB} << 18, np.float32) for _ in range(3))
roofline.triad(roofline.BANDS, a, b, c)
for by_loop in (False, True):
    memory = counted.TouchedMemory(by_loop=by_loop)
    memory.total()
    before = memory.total()
    for _ in range(3):
        roofline.triad(roofline.BANDS, a, b, c)
    found[f"bytes {{by_loop}}"] = memory.total() - before
json.dump(found, sys.stdout)
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    environment = {"NUMBA_CACHE_DIR": str(tmp_path_factory.mktemp("cache")), "NUMBA_NUM_THREADS": "1"}
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=Path(__file__).parents[3], env=os.environ | IN_HEAP | environment,
        stdout=subprocess.PIPE, timeout=120, check=True,
    )  # fmt: skip
    counts: dict[str, Any] = json.loads(result.stdout)
    return counts


def test_every_operation_of_a_vectorised_loop_counts_once(found: dict[str, Any]) -> None:
    assert found["flops"] == 32 * ROWS * COLUMNS * found["passes"]
    assert found["instructions"] < found["flops"] / 2  # vectors


def test_every_touched_page_counts_once_for_a_stage_or_once_for_a_loop(found: dict[str, Any]) -> None:
    planes = 3 * PLANES_MB << 20
    assert found["bytes False"] == pytest.approx(planes, rel=0.1)
    assert found["bytes True"] == pytest.approx(3 * planes, rel=0.1)


@pytest.mark.parametrize(
    ("line", "counts"),
    [
        ("  %5 = fadd reassoc nsz <8 x float> %3, %4", (8, 0, 1)),
        ("  %.7 = fmul float %a, 2.000000e+00", (1, 0, 1)),
        ("  %9 = tail call fast <4 x float> @llvm.sqrt.v4f32(<4 x float> %8)", (4, 0, 1)),
        ("  %9 = call float @llvm.fma.f32(float %1, float %2, float %3)", (2, 0, 1)),
        ("  %9 = call <16 x i16> @llvm.umin.v16i16(<16 x i16> %1, <16 x i16> %2)", (0, 16, 1)),
        ("  %6 = fcmp reassoc olt <8 x float> %4, %5", (0, 8, 1)),
        ("  %6 = select i1 %5, float %1, float %2", (0, 1, 1)),
        ("  %6 = select <8 x i1> %5, <8 x float> %1, <8 x float> %2", (0, 8, 1)),
        ("  %6 = zext <16 x i8> %5 to <16 x i16>", (0, 16, 1)),
        ("  %index.next = add nuw i64 %index, 8", (0, 0, 1)),
        ("  %wide.load = load <8 x float>, ptr %3, align 4", (0, 0, 1)),
        ("  %index = phi i64 [ 0, %entry ], [ %next, %body ]", (0, 0, 0)),
        ("body:", (0, 0, 0)),
    ],
)
def test_an_instruction_counts_by_its_elements(line: str, counts: tuple[int, int, int]) -> None:
    assert counts_of(line) == counts


def test_only_blocks_that_execute_something_count_and_before_their_end() -> None:
    body = "define void @f() {\nentry:\n  %1 = fadd float %a, %b\n  br label %end\nend:\n  ret void\n}"
    lines = instrumented(body).splitlines()
    added = [i for i, line in enumerate(lines) if "atomicrmw" in line]
    assert len(added) == 2 and lines[added[-1] + 1] == "  br label %end"
