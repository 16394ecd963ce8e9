"""What stands in for OpenVSF and torch; scripts/openvsf_round_trip.py asks the real ones."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


class Tensor:
    """As much of torch's as is asked of one."""

    def __init__(self, array: NDArray[Any]) -> None:
        self._array = array

    def detach(self) -> "Tensor":
        return self

    cpu = detach

    def numpy(self) -> NDArray[Any]:
        return self._array


class PointVSF:
    """As much of OpenVSF's as is asked of one."""

    axis_mode = "isotropic"

    def __init__(self, rest_points: Tensor) -> None:
        self.rest_points = rest_points
        self.stiffness = Tensor(np.zeros(len(rest_points.numpy())))
        self.features: dict[str, Tensor] = {}

    def set_feature(self, name: str, feature: Tensor) -> None:
        assert len(feature.numpy()) == len(self.rest_points.numpy())
        self.features[name] = feature
