"""Request of memory that a kernel needs soon.

The processor recognises streams by itself, within a page. A kernel that works down a narrow tile of a large image comes
to another page with each row, and would wait for the memory at the beginning of every one.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.core.imputils import impl_ret_untracked
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

LINE = 64
"""Bytes of a cache line."""


@intrinsic
def prefetch(typing_context: Any, array: Any, at: Any) -> Any:  # noqa: ARG001
    """Fetch the cache line of element number ``at`` of a contiguous array; elements beyond the array do no harm."""
    return types.void(array, at), _emit


def _emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    array, at = values
    data = make_array(signature.args[0])(context, builder, array).data
    byte, word = ir.IntType(8).as_pointer(), ir.IntType(32)
    pointer = builder.bitcast(builder.gep(data, [at]), byte)
    function = ir.FunctionType(ir.VoidType(), [byte, word, word, word])
    known = builder.module.globals.get("llvm.prefetch.p0i8")
    function = known or ir.Function(builder.module, function, "llvm.prefetch.p0i8")
    # To read, into all levels, data.
    builder.call(function, [pointer, word(0), word(3), word(1)])
    return impl_ret_untracked(context, builder, signature.return_type, context.get_dummy_value())
