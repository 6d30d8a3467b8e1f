"""Costs of a pixel's labels as vectors: one step of an aggregation path, and the two least totals.

A pixel has 10 to 60 labels. For loops so short the compiler's own vector code loses more on its tests for overlapping
arrays and on the labels that are left over than it gains: a step took 165 processor cycles. Here the vectors are
explicit, and the labels a multiple of :data:`LANES`; the compiler divides the vectors where a processor's are shorter.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.types.containers import Tuple
from numba.extending import intrinsic

LANES = 8
_FLAGS = ("nnan", "nsz", "contract")
_FLOAT, _INT, _WORD = ir.FloatType(), ir.IntType(32), ir.IntType(64)
_VECTOR = ir.VectorType(_FLOAT, LANES)
_UNREACHED = 1e9


def padded(labels: int) -> int:
    """Number of labels that are kept for each pixel."""
    return -(-labels // LANES) * LANES


class _Vectors:
    """Code of vector operations at the builder's place."""

    def __init__(self, context: Any, builder: Any) -> None:
        self._context, self._builder = context, builder

    def data(self, kind: Any, array: Any) -> Any:
        """Pointer to an array's first number."""
        return self._context.make_array(kind)(self._context, self._builder, array).data

    def place(self, data: Any, index: Any) -> Any:
        """Pointer to the vector that starts at an index."""
        return self._builder.bitcast(self._builder.gep(data, [index]), _VECTOR.as_pointer())

    def load(self, data: Any, index: Any) -> Any:
        """The vector that starts at an index."""
        return self._builder.load(self.place(data, index), align=4)

    def all(self, value: Any) -> Any:
        """A vector of one number."""
        b = self._builder
        first = b.insert_element(ir.Constant(_VECTOR, ir.Undefined), value, _INT(0))
        return b.shuffle_vector(first, first, ir.Constant(ir.VectorType(_INT, LANES), [0] * LANES))

    def less(self, a: Any, b: Any) -> Any:
        """The lesser numbers of two vectors."""
        return self._builder.select(self._builder.fcmp_ordered("<", a, b, flags=_FLAGS), a, b)

    def more(self, a: Any, b: Any) -> Any:
        """The greater numbers of two vectors."""
        return self._builder.select(self._builder.fcmp_ordered("<", a, b, flags=_FLAGS), b, a)

    def least(self, vector: Any) -> Any:
        """The least number of a vector."""
        shape = ir.FunctionType(_FLOAT, [_VECTOR])
        name = f"llvm.vector.reduce.fmin.v{LANES}f32"
        function = cgutils.get_or_insert_function(self._builder.module, shape, name)
        return self._builder.call(function, [vector], fastmath=("nnan",))

    def bits(self, mask: Any) -> Any:
        """A vector of conditions as one number, the first in the lowest bit."""
        return self._builder.zext(self._builder.bitcast(mask, ir.IntType(LANES)), _WORD)


@intrinsic
def advance(
    context: Any, costs: Any, at: Any, paths: Any, old: Any, new: Any, least: Any, penalty: Any,  # noqa: ARG001
    keep: Any, total: Any, labels: Any,  # noqa: ARG001
) -> Any:  # fmt: skip
    """One step of a path: new(m) = cost(m) + min(old(m) - least, penalty); returns the least new.

    Args:
        costs, total: flat; ``at``: a pixel's first label in both; ``total`` becomes keep * total + new.
        paths: flat; ``old``, ``new``: first labels of the neighbour, already displaced, and of the pixel.
        labels: a multiple of LANES.
    """
    number, word = types.float32, types.intp

    def code(target: Any, builder: Any, signature: Any, values: Any) -> Any:
        v = _Vectors(target, builder)
        costs_at, paths_at, total_at = (v.data(signature.args[k], values[k]) for k in (0, 2, 8))
        first, source, into = values[1], values[3], values[4]
        lowest, limit, kept = v.all(values[5]), v.all(values[6]), v.all(values[7])
        result = cgutils.alloca_once_value(builder, ir.Constant(_VECTOR, [_UNREACHED] * LANES))
        with cgutils.for_range(builder, builder.udiv(values[9], _WORD(LANES)), intp=_WORD) as loop:
            k = builder.mul(loop.index, _WORD(LANES))
            over = builder.fsub(v.load(paths_at, builder.add(source, k)), lowest, flags=_FLAGS)
            here = builder.add(first, k)
            value = builder.fadd(v.load(costs_at, here), v.less(over, limit), flags=_FLAGS)
            builder.store(value, v.place(paths_at, builder.add(into, k)), align=4)
            before = builder.fmul(kept, v.load(total_at, here), flags=_FLAGS)
            builder.store(builder.fadd(before, value, flags=_FLAGS), v.place(total_at, here), align=4)
            builder.store(v.less(value, builder.load(result)), result)
        return v.least(builder.load(result))

    return number(costs, word, paths, word, word, number, number, number, total, word), code


@intrinsic
def least_two(context: Any, total: Any, at: Any, labels: Any) -> Any:  # noqa: ARG001
    """Label of the least of a pixel's values (the first of several), and the lead over the second least.

    Args:
        total: flat; ``at``: the pixel's first label; ``labels``: a multiple of LANES.
    """
    pair = Tuple((types.intp, types.float32))

    def code(target: Any, builder: Any, signature: Any, values: Any) -> Any:
        v = _Vectors(target, builder)
        data, first = v.data(signature.args[0], values[0]), values[1]
        groups = builder.udiv(values[2], _WORD(LANES))
        unreached = v.all(ir.Constant(_FLOAT, _UNREACHED))
        least, second = (cgutils.alloca_once_value(builder, unreached) for _ in range(2))
        with cgutils.for_range(builder, groups, intp=_WORD) as loop:
            value = v.load(data, builder.add(first, builder.mul(loop.index, _WORD(LANES))))
            before = builder.load(least)
            builder.store(v.less(builder.load(second), v.more(value, before)), second)
            builder.store(v.less(value, before), least)
        best = v.least(builder.load(least))
        # The first label of the least value, from the last group on down.
        where = cgutils.alloca_once_value(builder, _WORD(0))
        with cgutils.for_range(builder, groups, intp=_WORD) as loop:
            k = builder.mul(builder.sub(builder.sub(groups, loop.index), _WORD(1)), _WORD(LANES))
            equal = builder.fcmp_ordered("==", v.load(data, builder.add(first, k)), v.all(best), flags=_FLAGS)
            found = v.bits(equal)
            label = builder.add(k, builder.cttz(found, ir.Constant(ir.IntType(1), 0)))
            none = builder.icmp_unsigned("==", found, _WORD(0))
            builder.store(builder.select(none, builder.load(where), label), where)
        # One of the vector's least values is the best; several may be.
        minima = builder.load(least)
        own = builder.fcmp_ordered("==", minima, v.all(best), flags=_FLAGS)
        count = builder.ctpop(v.bits(own))
        others = v.least(builder.select(own, builder.load(second), minima))
        several = builder.icmp_unsigned(">", count, _WORD(1))
        runner_up = builder.select(several, best, others)
        lead = builder.fsub(runner_up, best, flags=_FLAGS)
        return target.make_tuple(builder, pair, [builder.load(where), lead])

    return pair(total, types.intp, types.intp), code
