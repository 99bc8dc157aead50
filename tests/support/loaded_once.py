"""Modules that a process can load once, loaded before `pytester` begins: it forgets what is imported while it runs.

Whoever imported them after it, in the same process, would get "cannot load module more than once per process".
"""

import numpy.fft
import numpy.linalg
import numpy.random

__all__ = ["numpy"]
