"""Parallel loops over numba's thread pool without numba's parallel transformation.

``parallel=True`` sends the body of a ``prange`` loop through passes for array expressions, fusion and reductions, and
compiles it about four times; here it is compiled once, as a function of the index. Threads take the next
indices from a shared counter in chunks: a thread that the operating system delays gets fewer of them. Each index is
processed by exactly one thread, so results do not depend on the number of threads as long as the bodies write to
different elements.

Uses internals of numba (``numba_parallel_for`` and the calling convention): numba is pinned to one version.
"""

from __future__ import annotations

from collections.abc import Callable
from types import FunctionType
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.types.containers import BaseTuple, Tuple
from numba.extending import intrinsic
from numba.np.ufunc import parallel as pool

from pipeline.common.jit import allocating, allocating_linked, linked

CHUNKS = 8
"""Chunks of indices per thread."""


class ParallelFor:
    """A compiled loop: ``loop(count, *arguments)`` calls the body with each index 0 .. count - 1 and the arguments.

    numba compiles (or loads) the body for each combination of argument types at the first call. The number of threads
    is that of :func:`numba.set_num_threads` in the calling thread. Not for calls from two threads at once, and not
    from compiled code.
    """

    def __init__(self, function: Callable[..., None], decorator: Any) -> None:
        self.body = decorator(function)
        self.py_func = function
        self.__name__, self.__doc__ = function.__name__, function.__doc__
        # The loop's own function belongs to the body's file, under which numba's cache keeps it.
        code = _loop.__code__.replace(
            co_filename=function.__code__.co_filename,
            co_firstlineno=function.__code__.co_firstlineno,
            co_name=f"{function.__name__}_loop",
        )
        loop = FunctionType(code, {"driver": _driver(self.body)}, f"{function.__name__}_loop")
        loop.__module__, loop.__qualname__ = function.__module__, f"{function.__name__}_loop"
        self.dispatcher = allocating(loop)

    def __call__(self, count: int, *arguments: Any) -> None:
        """Run the loop.

        Raises:
            MemoryError: a body could not allocate its scratch arrays; indices may be missing.
        """
        if not pool._is_initialized:
            pool._launch_threads()
        if self.dispatcher(count, *arguments):
            raise MemoryError(f"{self.__name__}: no memory for scratch arrays in a loop over {count} indices")


def parallel(function: Callable[..., None]) -> ParallelFor:
    """Make a function of an index and arguments a :class:`ParallelFor`."""
    return ParallelFor(function, linked)


def parallel_allocating(function: Callable[..., None]) -> ParallelFor:
    """The same for a function that allocates arrays or calls one that does."""
    return ParallelFor(function, allocating_linked)


def blocks(count: int, size: int) -> int:
    """Number of blocks of so many rows or columns; the last one may have fewer."""
    return -(-count // size)


def _loop(count: int, *arguments: Any) -> int:
    """Template of every loop's own function; ``driver`` is its only global name."""
    return driver(count, arguments)  # type: ignore[name-defined]  # noqa: F821


def _driver(dispatcher: Any) -> Any:
    """The intrinsic that runs a body on the thread pool; returns 0, or 1 if a body raised an exception."""
    typer = types.Dispatcher(dispatcher)

    @intrinsic
    def driver(context: Any, count: Any, arguments: Any) -> Any:  # noqa: ARG001
        call: Any = typer.get_call_type(context, (types.intp, *arguments.types), {})
        return types.intp(types.intp, arguments), _Emitter(dispatcher, tuple(call.args))

    return driver


class _Emitter:
    """Generates the call of ``numba_parallel_for`` for a body with these argument types.

    The state of a loop is a structure on the caller's stack: next index, failure, count, chunk, arguments.
    """

    def __init__(self, dispatcher: Any, signature: tuple[Any, ...]) -> None:
        self._dispatcher, self._types = dispatcher, signature

    def __call__(self, target: Any, builder: Any, signature: Any, values: Any) -> Any:  # noqa: ARG002
        count, packed = values
        packed = _without_owners(target, builder, Tuple(self._types[1:]), packed)
        word, byte = target.get_value_type(types.intp), ir.IntType(8).as_pointer()
        layout = ir.LiteralStructType([word, word, word, word, packed.type])
        state = cgutils.alloca_once(builder, layout)
        threads = builder.call(_external(builder, "get_num_threads", ir.FunctionType(word, [])), [])
        chunk = builder.sdiv(count, builder.mul(threads, word(CHUNKS)))
        chunk = builder.select(builder.icmp_signed("<", chunk, word(1)), word(1), chunk)
        for k, value in enumerate((word(0), word(0), count, chunk, packed)):
            builder.store(value, cgutils.gep_inbounds(builder, state, 0, k))
        worker = self._worker(target, builder, layout, word, byte)
        # A ufunc loop over as many "elements" as threads; the only array's address is never used.
        arrays = cgutils.alloca_once_value(builder, ir.Constant(byte, None))
        sizes, steps = cgutils.alloca_once_value(builder, threads), cgutils.alloca_once_value(builder, word(0))
        run = _external(builder, "numba_parallel_for", ir.FunctionType(ir.VoidType(), [byte] * 5 + [word] * 3))
        pointers = [builder.bitcast(p, byte) for p in (worker, arrays, sizes, steps, state)]
        builder.call(run, [*pointers, word(0), word(1), threads])
        return builder.load(cgutils.gep_inbounds(builder, state, 0, 1))

    def _worker(self, target: Any, builder: Any, layout: Any, word: Any, byte: Any) -> Any:
        """What one thread runs: takes chunks of indices until none is left."""
        shape = ir.FunctionType(ir.VoidType(), [byte.as_pointer(), word.as_pointer(), word.as_pointer(), byte])
        name = builder.module.get_unique_name(f"{self._dispatcher.py_func.__name__}_worker")
        worker = ir.Function(builder.module, shape, name=name)
        worker.linkage = "internal"
        b = ir.IRBuilder(worker.append_basic_block("entry"))
        state = b.bitcast(worker.args[3], layout.as_pointer())
        following, failed, count, chunk, packed = (cgutils.gep_inbounds(b, state, 0, k) for k in range(5))
        count, chunk = b.load(count), b.load(chunk)
        arguments = [b.load(cgutils.gep_inbounds(b, packed, 0, k)) for k in range(len(self._types) - 1)]
        compiled = self._dispatcher.overloads[self._types]
        target.active_code_library.add_linking_library(compiled.library)
        callee = target.declare_function(builder.module, compiled.fndesc)
        take, some, done = (worker.append_basic_block(name) for name in ("take", "some", "done"))
        b.branch(take)
        b.position_at_end(take)
        first = b.atomic_rmw("add", following, chunk, "monotonic")
        b.cbranch(b.icmp_signed("<", first, count), some, done)
        b.position_at_end(some)
        rest = b.sub(count, first)
        with cgutils.for_range(b, b.select(b.icmp_signed("<", rest, chunk), rest, chunk), intp=word) as loop:
            status, _ = target.call_conv.call_function(
                b, callee, compiled.signature.return_type, self._types, [b.add(first, loop.index), *arguments]
            )
            with b.if_then(status.is_error, likely=False):
                b.store(word(1), failed)
        b.branch(take)
        b.position_at_end(done)
        b.ret_void()
        return worker


def _without_owners(target: Any, builder: Any, kind: Any, value: Any) -> Any:
    """A value whose arrays have no owner: the caller keeps them alive while the loop runs.

    Every slice counts a reference to the owner of its array. Threads that count references to the same array wait for
    each other at each row: loops with little work on a row took longer with two threads than with one.
    """
    if isinstance(kind, types.Array):
        array = target.make_array(kind)(target, builder, value)
        array.meminfo = ir.Constant(array.meminfo.type, None)
        return array._getvalue()
    if isinstance(kind, BaseTuple):
        for k, part in enumerate(kind.types):
            stripped = _without_owners(target, builder, part, builder.extract_value(value, k))
            value = builder.insert_value(value, stripped, k)
    return value


@intrinsic
def unowned(context: Any, value: Any) -> Any:  # noqa: ARG001
    """An array, or a tuple of arrays, without an owner, for functions that several threads call with the same arrays.

    The caller keeps the arrays alive while the result is used.
    """

    def generate(target: Any, builder: Any, signature: Any, values: Any) -> Any:  # noqa: ARG001
        return _without_owners(target, builder, value, values[0])

    return value(value), generate


def _external(builder: Any, name: str, shape: Any) -> Any:
    return cgutils.get_or_insert_function(builder.module, shape, name)
