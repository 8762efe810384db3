"""Numerical kernels, compiled when the workspace is built: no measurement waits for a compiler."""
