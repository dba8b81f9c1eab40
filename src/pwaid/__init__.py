"""pwaid: piecewise-affine identification, and what a simulator leaves out of its machine."""

from pwaid._version import __version__

__all__ = ["__version__"]
