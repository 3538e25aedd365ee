"""Kernels inside kernels: what only compiled code calls is not made executable by itself.

Numba compiles every kernel as if Python called it: with wrappers that unpack Python objects, with
all optimisations, and with machine code of its own, although a kernel that calls it takes in and
optimises its code once more. Of a cold start this was a third. Here a call from a kernel takes the
code as it was lowered; optimisation and machine code are left to the kernel that Python calls.
"""

from __future__ import annotations

import gc
from collections.abc import Callable
from typing import Any

from llvmlite.binding import parse_bitcode
from numba.core.caching import Cache, CompileResultCacheImpl
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, CompileResult, DefaultPassBuilder, compile_result
from numba.core.registry import CPUDispatcher
from numba.core.types import unliteral


def inlined(kernel: Any) -> Any:
    """The dispatcher of which kernels that call ``kernel`` take the code."""
    inner = _InnerDispatcher(kernel.py_func, kernel.locals, kernel.targetoptions, _InnerCompiler)
    kernel.get_call_template = inner.get_call_template
    kernel.get_overload = inner.get_overload
    kernel.compile = _uncollected(kernel.compile)
    return inner


def _uncollected(compile_: Callable[..., Any]) -> Callable[..., Any]:
    """Without garbage collection, which searches in vain through what a compilation holds."""

    def uncollected(sig: Any) -> Any:
        collects = gc.isenabled()
        gc.disable()
        try:
            return compile_(sig)
        finally:
            if collects:
                gc.enable()

    return uncollected


class _InnerLibrary(JITCodeLibrary):
    """Code to be taken in by another library; it is never loaded for execution."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _InnerCompiler(CompilerBase):
    def define_pipelines(self) -> list[Any]:
        state = self.state
        state.library = _InnerLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        flags = state.flags
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        return [DefaultPassBuilder.define_nopython_pipeline(state)]

    def _compile_core(self) -> Any:
        result = super()._compile_core()
        # callers find the code by this key, which stands for the address that it does not have
        key = object()
        result.target_context.insert_user_function(key, result.fndesc, [result.library])
        return result._replace(entry_point=key)


class _Stored(CompileResultCacheImpl):
    """Lowered code on disk, beside what is executable."""

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        return f"inner-{super().get_filename_base(fullname, abiflags)}"

    def reduce(self, cres: Any) -> Any:
        cres.fndesc.typemap = cres.fndesc.calltypes = None
        return (
            cres.library.serialize_using_bitcode(),
            cres.fndesc,
            cres.environment,
            cres.signature,
        )

    def rebuild(self, target_context: Any, payload: Any) -> CompileResult:
        (name, _, code), fndesc, environment, signature = payload
        library = _InnerLibrary(target_context.codegen(), name)
        library._final_module = parse_bitcode(code)
        library._finalize_final_module()
        return compile_result(
            typing_context=target_context.typing_context,
            target_context=target_context,
            library=library,
            environment=environment,
            entry_point=object(),
            fndesc=fndesc,
            signature=signature,
            objectmode=False,
            lifted=(),
        )


class _InnerCache(Cache):
    _impl_class = _Stored


class _InnerDispatcher(CPUDispatcher):
    def enable_caching(self) -> None:
        self._cache = _InnerCache(self.py_func)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Of a call with a number that is written out: one code for every number of its type."""
        plain = {name: unliteral(kind) for name, kind in kws.items()}
        return super().get_call_template(tuple(map(unliteral, args)), plain)

    def add_overload(self, cres: Any) -> None:
        self.overloads[tuple(cres.signature.args)] = cres
