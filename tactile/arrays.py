"""Type aliases of numpy arrays by the type of their elements."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
"""Array of double-precision floats."""
Singles = NDArray[np.float32]
"""Array of single-precision floats."""
Complex = NDArray[np.complex128]
"""Array of double-precision complex numbers."""
Ints = NDArray[np.int64]
"""Array of 64-bit integers."""
Bytes = NDArray[np.uint8]
"""Array of unsigned 8-bit integers."""
