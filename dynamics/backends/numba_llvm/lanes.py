"""Compiled functions on all lanes of the workspace: vector code, or plain numba if it must be."""

from dynamics.runtime.numba_internals import USABLE

if USABLE:
    from dynamics.backends.numba_llvm.moves import block_moves, lane_moves, row_moves
    from dynamics.backends.numba_llvm.vector_code import straight_line
else:
    from dynamics.backends.numba_llvm.plain_code import (
        block_moves,
        lane_moves,
        row_moves,
        straight_line,
    )

__all__ = ["block_moves", "lane_moves", "row_moves", "straight_line"]
