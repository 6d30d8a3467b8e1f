"""Functions that count no references to arrays receive no array from a function that does: nothing would release it."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError

import pipeline
from pipeline.common.jit import allocating, serial
from pipeline.common.parallel_for import ParallelFor, parallel, parallel_allocating


def compiled(value: Any) -> Any:
    """The compiled function of a module's attribute, or nothing."""
    value = value.body if isinstance(value, ParallelFor) else value
    return value if isinstance(value, Dispatcher) else None


def counts(function: Any) -> bool:
    return bool(function.targetoptions.get("_nrt", True))


def modules() -> Iterator[ModuleType]:
    for found in pkgutil.walk_packages(pipeline.__path__, "pipeline."):
        yield importlib.import_module(found.name)


def misuses(values: dict[str, Any]) -> list[str]:
    """Functions of a module that count no references, with each that they call and that does."""
    found = []
    for function in filter(None, map(compiled, values.values())):
        names = function.py_func.__code__.co_names
        called = [compiled(function.py_func.__globals__.get(name)) for name in names]
        if not counts(function):
            found += [f"{function.py_func.__qualname__}: {one.__name__}" for one in called if one and counts(one)]
    return found


def test_no_kernel_without_counts_calls_one_that_counts() -> None:
    kernels = [function for module in modules() for function in filter(None, map(compiled, vars(module).values()))]
    assert sum(map(counts, kernels)) > 20 and sum(not counts(one) for one in kernels) > 200
    assert not [problem for module in modules() for problem in misuses(vars(module))]


@allocating
def _doubled(x: Any) -> Any:
    return 2 * x.copy()


@serial
def _without_counts(x: Any) -> float:
    return float(_doubled(x)[0])


@parallel
def _loop_without_counts(i: int, x: Any) -> None:
    x[i] = _doubled(x)[i]


@parallel_allocating
def _loop(i: int, x: Any) -> None:
    x[i] = _doubled(x)[i]


def test_such_calls_are_found() -> None:
    assert misuses(globals()) == ["_without_counts: _doubled", "_loop_without_counts: _doubled"]


def test_an_allocation_without_counts_does_not_compile() -> None:
    @serial
    def allocate(n: int) -> float:
        return float(np.zeros(n)[0])

    with pytest.raises(NumbaError):
        allocate(3)
