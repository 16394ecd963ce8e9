"""Adds what a camera saw of an object to a field, for planning."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._palpate import Field

_PIXEL_RAD = 0.012
"""Angle of a pixel of the depth image that decides which cells are hidden, rad."""

_HALF = 85
"""Half of the width of this image, pixels; must exceed 1 / _PIXEL_RAD."""


def with_view(field: Field, cloud: ArrayLike, viewpoint: ArrayLike) -> Field:
    """A field for planning: `field`, corrected by what a camera at `viewpoint` (3,) m saw of the object at rest.

    `cloud` are the seen points of the object only, (M, 3) m. In their bounding box, enlarged by 10 cm, cells in
    front of or beside the points lose their stiffness: the camera saw that they are empty. Cells behind the
    points that were neither seen nor touched get the mean stiffness of the touched cells that remain in the box.
    The new field has no memory, no bands and no elastic body.

    The whole box must be in the camera's image, and nothing else, such as the arm, may hide it: a direction
    without seen points counts as empty.
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
    first = np.full((2 * _HALF + 1,) * 3, np.inf)  # distance of the nearest seen point in each direction, m
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
