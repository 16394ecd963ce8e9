"""Moves springs at any points to the points of a lattice; springs in the same cell are in parallel.

    K = Σ Kᵢ        variance = Σ varianceᵢ        count = max countᵢ

so the total stiffness is the same, and only positions change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._palpate import Lattice

NEAR_CELLS = 1e-3
"""Largest distance, in cells, at which points count as points of a lattice; single precision is more accurate."""

_SAMPLED = 128
"""Number of points whose nearest neighbours determine the spacing of points that are on no lattice."""

_ROUND = 6
"""Number of digits to which a spacing is rounded, if the points still fit."""


@dataclass(frozen=True)
class Springs:
    """N springs: `points` (N, 3) m, `stiffness` (N,) N/m, `variance` (N,) (N/m)², `counts` (N,)."""

    points: NDArray[np.float64]
    stiffness: NDArray[np.float64]
    variance: NDArray[np.float64]
    counts: NDArray[np.float64]


@dataclass(frozen=True)
class Moved:
    """How far points were moved to a lattice."""

    mean_m: float
    largest_m: float
    merged: int
    """Number of points that share the cell of another one."""


def lattice_of(points: NDArray[np.float64], spacing: float | None = None) -> Lattice:
    """The lattice that `points` (N, 3) m lie on, or else one that covers them.

    Its spacing, m, is deduced if left out. Raises ValueError if the spacing is invalid or too small.
    """
    if spacing is None:
        return holding(points) or spanning(points, typical_spacing(points))
    if not (math.isfinite(spacing) and spacing > 0.0):
        raise ValueError(f"`spacing` is {spacing}; wanted more than 0 m")
    return spanning(points, spacing)


def holding(points: NDArray[np.float64]) -> Lattice | None:
    """The lattice of equal spacing that all `points` (N, 3) m lie on, None if there is none."""
    origin = points.min(axis=0)
    steps = np.diff(np.sort(points, axis=0), axis=0)
    tiny_m = 8 * float(np.finfo(np.float32).eps) * float(np.abs(points).max())
    steps = steps[steps > max(tiny_m, 1e-9)]
    if len(steps) == 0:
        return None
    # The smallest step is one cell, up to rounding; a fit to all points is more accurate.
    spacing = float(steps.min())
    offsets = points - origin
    for _ in range(3):
        cells = np.rint(offsets / spacing)
        spacing = float((cells * offsets).sum() / (cells * cells).sum())
    for candidate in (float(f"{spacing:.{_ROUND}g}"), spacing):
        cells = np.rint(offsets / candidate)
        if np.abs(offsets - cells * candidate).max() <= NEAR_CELLS * candidate:
            return spanning(points, candidate)
    return None


def spanning(points: NDArray[np.float64], spacing: float) -> Lattice:
    """The lattice with this spacing, m, that begins at the low corner of `points` and covers all of them."""
    low, high = points.min(axis=0), points.max(axis=0)
    sides = [math.floor(edge / spacing + 0.5) + 1 for edge in (high - low).tolist()]
    if math.prod(sides) >= 1 << 32:
        raise ValueError(
            f"`points` reach from {low.tolist()} to {high.tolist()} m: a spacing of {spacing:.6g} m makes "
            f"{' x '.join(map(str, sides))} cells, and a lattice has less than 2^32; give a larger "
            "`spacing`, or leave out distant points"
        )
    return Lattice(low, spacing, sides)


def typical_spacing(points: NDArray[np.float64]) -> float:
    """The median distance of `points` (N, 3) to their nearest neighbours, m, from a sample of them."""
    rows = np.unique(np.linspace(0, len(points) - 1, _SAMPLED).astype(int))
    nearest = []
    for row in rows:
        gaps = np.square(points - points[row]).sum(axis=1)
        gaps = gaps[gaps > 0.0]
        if len(gaps):
            nearest.append(math.sqrt(float(gaps.min())))
    if not nearest:
        raise ValueError("`points` are all at one place, which determines no spacing; give `spacing`")
    return float(np.median(nearest))


def brought_to(lattice: Lattice, springs: Springs) -> tuple[Springs, Moved]:
    """Moves every spring to the nearest point of `lattice`; cells are in the order of their first spring.

    Raises ValueError if a point lies outside.
    """
    cells = lattice.cells(springs.points)
    outside = int((cells < 0).sum())
    if outside:
        low, high = springs.points.min(axis=0).tolist(), springs.points.max(axis=0).tolist()
        raise ValueError(
            f"{outside} of {len(cells)} points lie outside the lattice; they reach from {low} to "
            f"{high} m"
        )
    _, first, place = np.unique(cells, return_index=True, return_inverse=True)
    order = np.argsort(first)
    place = np.argsort(order)[place]
    n = len(order)
    stiffness, variance, counts = np.zeros(n), np.zeros(n), np.zeros(n)
    np.add.at(stiffness, place, springs.stiffness)
    np.add.at(variance, place, springs.variance)
    np.maximum.at(counts, place, springs.counts)
    points = lattice.points(cells[first[order]])
    brought = Springs(points, stiffness, variance, counts)
    gaps = np.linalg.norm(points[place] - springs.points, axis=1)
    return brought, Moved(float(gaps.mean()), float(gaps.max()), len(cells) - n)
