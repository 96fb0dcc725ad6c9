"""Generated modules that numba compiles, straight-line functions through LLVM."""
