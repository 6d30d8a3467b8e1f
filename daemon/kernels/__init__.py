"""Compilation of the kernels: what is to be compiled, in how many processes, and what is in the cache."""
