"""Functions that count no references to arrays receive no array from a function that does: nothing would release it.
Linked functions have no machine code of their own, and are called by compiled ones only."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import numpy as np
import pytest
from numba import types
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError

import pipeline
from pipeline.common.jit import allocating, inline, linked, serial
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


def kernels_of_all() -> list[Any]:
    return [function for module in modules() for function in filter(None, map(compiled, vars(module).values()))]


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
    kernels = kernels_of_all()
    assert sum(map(counts, kernels)) > 20 and sum(not counts(one) for one in kernels) > 200
    assert not [problem for module in modules() for problem in misuses(vars(module))]


def calls_from_python(module: ModuleType) -> list[str]:
    """Functions that are not compiled, and name one without machine code."""
    values = vars(module)
    kernels = {function.py_func.__code__.co_firstlineno for function in filter(None, map(compiled, values.values()))}
    without = {name for name, value in values.items() if isinstance(value, Dispatcher) and is_linked(value)}
    code = compile(Path(str(module.__file__)).read_text(encoding="utf-8"), str(module.__file__), "exec")
    plain = [one for one in nested(code) if one is not code and one.co_firstlineno not in kernels]
    return [f"{one.co_qualname}: {name}" for one in plain for name in one.co_names if name in without]


def is_linked(function: Any) -> bool:
    return bool(function.targetoptions.get("no_cpython_wrapper", False))


def nested(code: CodeType) -> Iterator[CodeType]:
    yield code
    for value in code.co_consts:
        if isinstance(value, CodeType):
            yield from nested(value)


def test_linked_functions_are_called_by_compiled_ones_only() -> None:
    kernels = kernels_of_all()
    assert sum(map(is_linked, kernels)) > 200 and sum(not is_linked(one) for one in kernels) > 50
    assert not [problem for module in modules() for problem in calls_from_python(module)]


@linked
def _halved(x: float) -> float:
    return x / 2


@inline
def _quarter(x: float) -> float:
    return _halved(_halved(x))


@serial
def _eighth(x: float) -> float:
    return _halved(_quarter(x))


def wrong_caller(x: float) -> float:
    return _quarter(x)


def test_linked_functions_get_machine_code_in_their_callers_alone() -> None:
    assert _eighth(3.0) == 0.375
    _halved.compile((types.float64,))  # where _eighth comes from numba's cache, nothing has compiled what it calls
    ((_, made),) = _halved.overloads.items()
    assert made.library.get_pointer_to_function(made.fndesc.llvm_func_name) == 0
    assert "wrong_caller: _quarter" in calls_from_python(importlib.import_module(__name__))


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
