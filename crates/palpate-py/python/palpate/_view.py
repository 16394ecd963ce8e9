"""What a camera saw of an object, put into a field to plan with."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._palpate import Field

_PIXEL_RAD = 0.012
"""Of the picture that says what the camera did not see."""

_HALF = 85
"""Half of its width in pixels: more than 1 / _PIXEL_RAD."""


def with_view(field: Field, cloud: ArrayLike, viewpoint: ArrayLike) -> Field:
    """A field to plan with: one of touches, and what a camera at `viewpoint` (3,) m saw of the object at rest.

    `cloud` are the seen points of the object alone, (M, 3) m. Within 10 cm of their box, cells in front of them or
    beside them lose their stiffness: the camera saw that nothing is there. Cells behind them that were neither seen nor
    touched get the mean stiffness of the touched cells that are left in the box. The new field has neither memory, bands nor
    an elastic body.

    Everything in that box must be in the picture, and nothing else may hide it, such as the arm: what the camera did not
    see at all counts as seen to be empty.
    """
    seen, eye, lattice = np.asarray(cloud, dtype=np.float64), np.asarray(viewpoint, dtype=np.float64), field.lattice
    if seen.ndim != 2 or seen.shape[1] != 3 or not len(seen) or eye.shape != (3,):
        raise ValueError(f"`cloud` and `viewpoint` are {seen.shape} and {eye.shape}; wanted (M, 3) and (3,)")
    sides = zip(seen.min(0) - 0.1, seen.max(0) + 0.1, strict=True)
    grid = np.meshgrid(*(np.arange(low, high, lattice.spacing) for low, high in sides))
    box = np.setdiff1d(lattice.cells(np.stack(grid, axis=-1).reshape(-1, 3)), [-1])
    around = np.array(list(np.ndindex(3, 3, 3))) - 1
    unseen = np.setdiff1d(box, lattice.cells((seen[:, None] + lattice.spacing * around).reshape(-1, 3)))

    def directions(points: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        distance = np.linalg.norm(points - eye, axis=1)
        return np.round((points - eye) / distance[:, None] / _PIXEL_RAD).astype(np.int64) + _HALF, distance

    pixels, distances = directions(seen)
    first = np.full((2 * _HALF + 1,) * 3, np.inf)  # the nearest seen point of each direction
    for shift in around:
        np.minimum.at(first, tuple((pixels + shift).T), distances)
    pixels, distances = directions(lattice.points(unseen))
    hidden = distances > first[tuple(pixels.T)]
    kept = ~np.isin(field.cells, unseen[~hidden])
    touched = kept & (field.counts > 0) & np.isin(field.cells, box)
    new = np.setdiff1d(unseen[hidden], field.cells)
    mean = field.stiffness[touched].mean() if touched.any() else 0.0
    return Field.from_arrays(
        np.concatenate([field.points[kept], lattice.points(new)]),
        np.concatenate([field.stiffness[kept], np.full(len(new), mean)]),
        counts=np.concatenate([field.counts[kept], np.zeros(len(new), np.uint32)]),
        lattice=lattice,
        robot=field.robot_name,
        contact=field.contact,
    )
