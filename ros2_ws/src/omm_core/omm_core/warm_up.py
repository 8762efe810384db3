"""Compile all kernels once, so that no measurement waits for the compiler (see ./omm)."""
