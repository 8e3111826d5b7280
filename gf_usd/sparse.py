"""SciPy's sparse matrices, loaded without what of NumPy nobody here asks for.

SciPy copies all public names of NumPy into a module of its own, and some of them are submodules
that NumPy loads when they are asked for: the generator of Fortran wrappers, masked arrays, tools
for tests.  That took 0.07 CPU seconds of every start.  While SciPy is loaded, NumPy does not name
them; whoever asks for one later gets it as ever.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import numpy as np

UNASKED = frozenset(
    ("char", "ctypeslib", "f2py", "ma", "polynomial", "rec", "test", "testing", "typing")
)
LISTS = ("__all__", "__numpy_submodules__")


@contextlib.contextmanager
def unnamed() -> Iterator[None]:
    """Have NumPy not name the submodules UNASKED; where it keeps no such lists, nothing changes."""
    kept = {name: getattr(np, name) for name in LISTS if hasattr(np, name)}
    for name, listed in kept.items():
        setattr(np, name, type(listed)(one for one in listed if one not in UNASKED))
    try:
        yield
    finally:
        for name, listed in kept.items():
            setattr(np, name, listed)


with unnamed():
    from scipy import sparse
    from scipy.sparse import coo_matrix, csr_matrix

__all__ = ["coo_matrix", "csr_matrix", "sparse"]
