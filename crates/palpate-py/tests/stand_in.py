"""Substitutes for OpenVSF and torch; scripts/openvsf_round_trip.py tests with the real ones."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


class Tensor:
    """The part of a torch tensor that is used."""

    def __init__(self, array: NDArray[Any]) -> None:
        self._array = array

    def detach(self) -> "Tensor":
        return self

    cpu = detach

    def numpy(self) -> NDArray[Any]:
        return self._array


class PointVSF:
    """The part of OpenVSF's PointVSF that is used."""

    axis_mode = "isotropic"

    def __init__(self, rest_points: Tensor) -> None:
        self.rest_points = rest_points
        self.stiffness = Tensor(np.zeros(len(rest_points.numpy())))
        self.features: dict[str, Tensor] = {}

    def set_feature(self, name: str, feature: Tensor) -> None:
        assert len(feature.numpy()) == len(self.rest_points.numpy())
        self.features[name] = feature
