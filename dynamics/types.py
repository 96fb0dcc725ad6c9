"""Type aliases for annotations."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
AnyArray = NDArray[Any]
Vector3 = tuple[float, float, float]
Matrix3 = tuple[Vector3, Vector3, Vector3]
TorqueSignal = Callable[[float], ArrayLike]  # (n_joint,) [N m], [N]; jumps listed in `.breakpoints`
Symbols = Mapping[str, Any]  # CasADi expressions by name
