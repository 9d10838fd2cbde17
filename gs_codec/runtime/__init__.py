"""Run-time support: kernels, threads, memory, other programs, files."""
