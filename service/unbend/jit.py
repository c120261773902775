"""Decorators that compile numeric kernels with Numba."""

from __future__ import annotations

import contextlib
import inspect
import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar, cast

import numba
from llvmlite import ir
from numba import types
from numba.core import caching, cgutils
from numba.core.event import Listener, register, unregister
from numba.extending import intrinsic

logger = logging.getLogger("unbend.jit")

P = ParamSpec("P")
R = TypeVar("R")

_READ: Final = 0  # the arguments of LLVM's prefetch: for reading, to stay in all caches, as data
_KEEP: Final = 3
_DATA: Final = 1


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` on first use, keep the machine code on disk, and run it without the GIL.

    Floating point stays strict (no fastmath), so results do not depend on how a loop is vectorised.
    """
    return _compiled(function)


def summing(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` like `kernel`, but let the compiler reorder its sums to fill vector registers.

    The order is fixed at compile time. It depends on the processor and on the number of terms, but not on their
    addresses or on the thread. Do not use this decorator for sums that must be equal on every processor.
    """
    return _compiled(function, fastmath={"reassoc"})


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` as a part of the kernels that call it; it makes no arrays, as in `borrowing`."""
    return _compiled(function, forceinline=True, _nrt=False)


def borrowing(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` like `kernel`, without counts of references to arrays.

    It borrows the arrays of its caller, and neither makes nor returns any. Numba counts references atomically whenever
    a function unpacks a tuple of arrays or passes an array on. In small steps that takes longer than the arithmetic.
    """
    return _compiled(function, _nrt=False)


def _compiled(function: Callable[P, R], **options: Any) -> Callable[P, R]:
    compiled = numba.njit(nogil=True, error_model="numpy", **options)(function)
    compiled._cache = _Cache(function)  # noqa: SLF001  as Numba's cache=True, but the folder may be read-only
    return cast("Callable[P, R]", compiled)


class _Chosen(caching.UserProvidedCacheLocator):
    """The folder of NUMBA_CACHE_DIR, even if nobody may write into it."""

    def ensure_cache_path(self) -> None:
        with contextlib.suppress(OSError):
            super().ensure_cache_path()


class _InTree(caching.InTreeCacheLocator):
    """The folder `__pycache__` next to the module, even if nobody may write into it."""

    def ensure_cache_path(self) -> None:
        with contextlib.suppress(OSError):
            super().ensure_cache_path()


class _CacheFiles(caching.CompileResultCacheImpl):
    def __init__(self, function: Any) -> None:
        self._locator_classes = [_Chosen, *self._locator_classes, _InTree]
        super().__init__(function)


class _Cache(caching.FunctionCache):
    """Numba's cache of a function; without a writable folder, it still reads what is there.

    Numba itself refuses to import such a function. A container with a read-only disk has all kernels in its image.
    """

    _impl_class = _CacheFiles

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save machine code if possible."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            logger.warning("compiled %s at run time, and cannot keep it: %s", self._name, error)


def _prefetch(_typing_context: Any, array: Any, _byte: Any) -> Any:
    """Prefetch the cache line at an offset in bytes into `array`, for a kernel that knows its next read."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        address = builder.gep(builder.bitcast(data, pointer), [arguments[1]])
        kind = ir.FunctionType(ir.VoidType(), [pointer, number, number, number])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        builder.call(function, [address, number(_READ), number(_KEEP), number(_DATA)])
        return context.get_dummy_value()

    return types.void(array, types.int64), generate


prefetch: Any = intrinsic(_prefetch)


class _CompilationListener(Listener):
    """Calls `tell` once, when compilations have taken `seconds` in sum."""

    def __init__(self, tell: Callable[[], None], seconds: float) -> None:
        self._tell = tell
        self._left = seconds
        self._depth = 0  # a kernel that calls another compiles it within its own compilation
        self._began = 0.0
        self._timer: threading.Timer | None = None

    def on_start(self, _event: Any) -> None:
        self._depth += 1
        if self._depth == 1 and self._left > 0:
            self._began = time.perf_counter()
            self._timer = threading.Timer(self._left, self._tell_once)
            self._timer.daemon = True
            self._timer.start()

    def on_end(self, _event: Any) -> None:
        self._depth -= 1
        if self._depth == 0 and self._timer:
            self._timer.cancel()
            self._left -= time.perf_counter() - self._began

    def _tell_once(self) -> None:
        self._left = 0.0
        self._tell()


def _announce() -> None:
    if sys.stderr is not None and sys.stderr.isatty():
        logger.warning("compiling the kernels once; this takes about a minute")


_ANNOUNCER: Final = _CompilationListener(_announce, 1.0)
register("numba:compile", _ANNOUNCER)


def on_compilation(tell: Callable[[], None], after: float = 1.0) -> Callable[[], None]:
    """Call `tell` once, in another thread, when this process has compiled kernels for `after` seconds.

    Kernels whose machine code is on disk are not compiled. Return a function that ends this.
    """
    listener = _CompilationListener(tell, after)
    register("numba:compile", listener)
    return lambda: unregister("numba:compile", listener)


class NotCompiledError(RuntimeError):
    """Within `without_compiling`: the machine code of a kernel is not on disk."""


class _Refusal(Listener):
    def on_start(self, _event: Any) -> None:
        raise NotCompiledError

    def on_end(self, _event: Any) -> None:
        """Do nothing: nothing was compiled."""


@contextlib.contextmanager
def without_compiling() -> Iterator[None]:
    """Within this context, a kernel that must be compiled raises NotCompiledError; one that is on disk is loaded."""
    refusal = _Refusal()
    unregister("numba:compile", _ANNOUNCER)  # it would hear the start of a compilation, and no end
    register("numba:compile", refusal)
    try:
        yield
    finally:
        unregister("numba:compile", refusal)
        register("numba:compile", _ANNOUNCER)


def is_compiled(compiled: Callable[..., Any]) -> bool:
    """Return whether the machine code of a kernel is on disk, and not older than its source.

    It may still be that of another processor, or of another version of Numba: then Numba compiles the kernel again.
    """
    source = Path(inspect.getfile(cast("Any", compiled).py_func))
    stem, changed = f"{source.stem}.{compiled.__name__}-", source.stat().st_mtime
    folder = Path(str(cast("Any", compiled).stats.cache_path))
    return any(file.stat().st_mtime >= changed for file in folder.glob(f"{stem}*.nbi"))
