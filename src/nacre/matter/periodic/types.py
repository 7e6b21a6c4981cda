"""The array type of the solvers: real, complex or whole numbers, as the docstrings say."""

from typing import Any

from numpy.typing import NDArray

Array = NDArray[Any]
