"""Arrays in NumPy's format of which another person may have written each byte."""

from __future__ import annotations

import tokenize
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from he3.errors import InvalidInput

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

UNREADABLE: Final = (
    OSError, ValueError, EOFError, RuntimeError, MemoryError, OverflowError, TypeError, tokenize.TokenError,
)  # fmt: skip
"""What NumPy raises for a damaged file, and for one whose header says what no array is."""


def mapped_array(path: Path) -> NDArray[Any]:
    """The array of an .npy file, read as far as it is used: a shape beyond the file's own size takes no memory.

    Raises InvalidInput, which says what is wrong and not with which file; FileNotFoundError if there is none.
    """
    try:
        values = np.load(path, allow_pickle=False, mmap_mode="r")
    except FileNotFoundError:
        raise
    except UNREADABLE as error:
        raise InvalidInput(str(error) or type(error).__name__) from None
    if not isinstance(values, np.ndarray):
        values.close()
        raise InvalidInput("an .npz file")
    return values
