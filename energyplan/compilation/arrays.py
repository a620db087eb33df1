"""Annotations of arrays in kernels: number type and number of dimensions, contiguous."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

READONLY, STRIDED = "read-only", "strided"
"""Marks of annotations: the array cannot be written; it need not be contiguous."""

Floats = Annotated[NDArray[np.float64], 1]
FloatTable = Annotated[NDArray[np.float64], 2]
FloatBlock = Annotated[NDArray[np.float64], 3]
WideBlock = Annotated[NDArray[np.float64], 4]
Singles = Annotated[NDArray[np.float32], 1]
SingleTable = Annotated[NDArray[np.float32], 2]
Ints = Annotated[NDArray[np.int64], 1]
IntTable = Annotated[NDArray[np.int64], 2]
ShortInts = Annotated[NDArray[np.int32], 1]
ShortIntTable = Annotated[NDArray[np.int32], 2]
Bytes = Annotated[NDArray[np.uint8], 1]
ByteTable = Annotated[NDArray[np.uint8], 2]
States = Annotated[NDArray[np.int8], 1]
Words = Annotated[NDArray[np.uint64], 1]
WordTable = Annotated[NDArray[np.uint64], 2]
WordBlock = Annotated[NDArray[np.uint64], 3]
Flags = Annotated[NDArray[np.bool_], 1]
FlagTable = Annotated[NDArray[np.bool_], 2]
"""A table has two dimensions, a block three, a wide block four."""

Column = Annotated[NDArray[np.float64], 1, STRIDED, READONLY]
AnyTable = Annotated[NDArray[np.float64], 2, STRIDED, READONLY]
AnyBlock = Annotated[NDArray[np.float64], 3, STRIDED, READONLY]
AnyInts = Annotated[NDArray[np.int64], 1, STRIDED, READONLY]
"""What is read alone may have any layout, as the columns of a table do."""
