"""Compiled kernels of the learned half: gradient steps, and whole games of small networks."""
