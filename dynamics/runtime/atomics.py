"""Atomic loads, stores and additions on int64 arrays, and the processor's spin-wait hint."""

import platform

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from dynamics.runtime.numba_internals import data_pointer

_X86: tuple[str, list[int]] = ("llvm.x86.sse2.pause", [])
_ARM: tuple[str, list[int]] = ("llvm.aarch64.hint", [1])
_PAUSES = {"x86_64": _X86, "AMD64": _X86, "aarch64": _ARM, "arm64": _ARM}


def _place(context, builder, signature, args):  # type: ignore[no-untyped-def]
    return builder.gep(data_pointer(context, builder, signature.args[0], args[0]), [args[1]])


@intrinsic
def load(typingctx, array, at):  # type: ignore[no-untyped-def]
    """Atomic load with acquire ordering."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.load_atomic(_place(context, builder, signature, args), "acquire", 8)

    return types.int64(array, at), codegen


@intrinsic
def store(typingctx, array, at, number):  # type: ignore[no-untyped-def]
    """Atomic store with release ordering."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        builder.store_atomic(args[2], _place(context, builder, signature, args), "release", 8)
        return context.get_dummy_value()

    return types.void(array, at, number), codegen


@intrinsic
def fetch_and_add(typingctx, array, at, number):  # type: ignore[no-untyped-def]
    """Atomic fetch-and-add; returns the old value."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        place = _place(context, builder, signature, args)
        return builder.atomic_rmw("add", place, args[2], "monotonic")

    return types.int64(array, at, number), codegen


@intrinsic
def pause(typingctx):  # type: ignore[no-untyped-def]
    """The spin-wait hint, which leaves resources to the core's other hardware thread."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        if platform.machine() in _PAUSES:
            name, numbers = _PAUSES[platform.machine()]
            kind = ir.FunctionType(ir.VoidType(), [ir.IntType(32) for _ in numbers])
            function = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)
            builder.call(function, [ir.IntType(32)(x) for x in numbers])
        return context.get_dummy_value()

    return types.void(), codegen
