"""CUDA C of programs, one thread per environment, and its compilation by NVRTC."""
