"""Every index is processed once, by any number of threads with the same result; failures are reported."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest
from numba.core import types
from numba.extending import intrinsic

from pipeline.common.jit import inline
from pipeline.common.parallel_for import blocks, parallel, parallel_allocating

pytestmark = pytest.mark.threads

_own_thread = types.ExternalFunction("pthread_self", types.uint64())

_AFTER_FORK = """
import os, sys
import numpy as np
from tests.pipeline.common.test_parallel_for import count_calls
out = np.zeros(100, np.int32)
count_calls(100, out)
child = os.fork()
if child == 0:
    count_calls(100, out)
    os._exit(0 if (out == 2).all() else 1)
_, status = os.waitpid(child, 0)
count_calls(100, out)
sys.exit(os.waitstatus_to_exitcode(status) or not (out == 2).all())
"""


@inline
def _root(x: Any) -> Any:
    return np.sqrt(x) / np.float32(3)


@parallel
def count_calls(i: int, out: Any) -> None:
    out[i] += 1


@parallel
def _sums(i: int, table: Any, out: Any) -> None:
    total = np.float32(0)
    for j in range(table.shape[1]):
        total += _root(table[i, j])
    out[i] = total


@parallel
def _note_thread(i: int, work: Any, out: Any) -> None:
    out[i] = _own_thread()
    for k in range(work.shape[0]):
        work[k, i] = np.sqrt(work[k, i] + 1.0)


@parallel
def _fail_at(i: int, last: int) -> None:
    if i == last:
        raise ValueError("no message reaches the caller")


@intrinsic
def _owner(context: Any, array: Any) -> Any:  # noqa: ARG001
    """Address of the structure that counts the references to an array's memory."""

    def generate(target: Any, builder: Any, signature: Any, values: Any) -> Any:
        array = target.make_array(signature.args[0])(target, builder, values[0])
        return builder.ptrtoint(array.meminfo, target.get_value_type(types.intp))

    return types.intp(array), generate


class _Pair(NamedTuple):
    left: Any
    right: Any


@parallel_allocating
def _owners(i: int, plain: Any, pair: Any, nested: Any, out: Any) -> None:
    out[i, 0], out[i, 1] = _owner(plain), _owner(plain[1:])
    out[i, 2], out[i, 3] = _owner(pair.left), _owner(pair.right[i])
    out[i, 4], out[i, 5] = _owner(nested[1][0]), _owner(np.empty(3))


@pytest.fixture
def all_threads():
    before = numba.get_num_threads()
    yield before
    numba.set_num_threads(before)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 15, 16, 17, 33, 1000, 4097])
def test_every_index_is_processed_once(count: int) -> None:
    out = np.zeros(max(count, 1), np.int32)
    count_calls(count, out)
    assert (out[:count] == 1).all()
    assert out[count:].sum() == 0


def test_the_result_does_not_depend_on_the_number_of_threads(all_threads: int) -> None:
    table = np.random.default_rng(1).random((501, 333), np.float32)
    results = []
    for threads in sorted({1, 2, all_threads} & set(range(1, all_threads + 1))):
        numba.set_num_threads(threads)
        out = np.empty(501, np.float32)
        _sums(501, table, out)
        results.append(out)
    np.testing.assert_allclose(results[0], np.sqrt(table).sum(axis=1) / 3, rtol=1e-4)
    for other in results[1:]:
        np.testing.assert_array_equal(other, results[0])


def test_no_more_threads_work_than_are_set(all_threads: int) -> None:
    for threads in range(1, all_threads + 1):
        numba.set_num_threads(threads)
        out = np.zeros(400, np.uint64)
        _note_thread(400, np.ones((2000, 400)), out)
        assert 1 <= len(set(out.tolist())) <= threads
        assert (out != 0).all()


def test_an_exception_in_a_body_is_reported() -> None:
    _fail_at(10, 10)
    with pytest.raises(MemoryError, match=r"_fail_at: .* 10 indices"):
        _fail_at(10, 9)


def test_a_forked_process_has_threads_of_its_own() -> None:
    # GNU OpenMP, which numba prefers where it is installed, ends forked processes with a message.
    environment = os.environ | {"PYTHONWARNINGS": "ignore", "NUMBA_THREADING_LAYER": "workqueue"}
    done = subprocess.run(
        [sys.executable, "-c", _AFTER_FORK], env=environment, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr


def test_threads_count_no_references_to_the_same_array() -> None:
    plain, left, right = np.zeros(5), np.zeros((2, 4), np.float32), np.zeros((8, 3), np.uint8)
    before = [sys.getrefcount(a) for a in (plain, left, right)]
    out = np.full((8, 6), -1, np.int64)
    _owners(8, plain, _Pair(left, right), (1, (left, 2.0)), out)
    assert (out[:, :5] == 0).all()
    assert (out[:, 5] != 0).all()  # an array of the body's own is released by its count
    assert [sys.getrefcount(a) for a in (plain, left, right)] == before


def test_blocks_cover_all_rows() -> None:
    assert [blocks(n, 8) for n in (0, 1, 8, 9, 16, 17)] == [0, 1, 1, 2, 2, 3]
