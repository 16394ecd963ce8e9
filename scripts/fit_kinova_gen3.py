#!/usr/bin/env python3
"""Fits the collision primitives of the built-in Kinova Gen3, and measures how well they fit.

    fit_kinova_gen3.py ROBOT_DIR             fit, print the table
    fit_kinova_gen3.py ROBOT_DIR --write     fit, print, put the shapes into the URDF
    fit_kinova_gen3.py ROBOT_DIR --check     measure the shapes that stand in the URDF

ROBOT_DIR holds the maker's geometry, which is not part of this project: `meshes/*.stl` (open
shells) and `convex_parts.npz` (convex pieces, arrays "<mesh>/<i>" of vertices). Every mode exits
with 1 if a limit is broken, and takes `--picture FILE.png`. Needs numpy, scipy and trimesh, and
matplotlib for the picture. A fit takes a few minutes on one core and is the same every time.

A link's surface is the surface of the union of its primitives. Both ways are measured: `real` are
points of the real surface against the primitives, `ours` are points of our surface against the
real one. The real surface is taken three times: `parts`, the outside of the union of the convex
pieces; `mesh`, the points of the mesh that are not inside the pieces, together with `parts` where
our surface closes an opening of the shell; `raw`, all points of the mesh, inner walls included,
which no solid can match: it is printed and not judged. Lengths are in metres unless a name says
otherwise, everything is in the link's frame.
"""

import argparse
import re
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from scipy.ndimage import map_coordinates
from scipy.optimize import least_squares
from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.transform import Rotation

URDF = Path(__file__).resolve().parents[1] / "crates/palpate/src/robot/kinova_gen3.urdf"
NEAR_MM, NEAR_SHARE, FAR_MM = 6.0, 0.90, 15.0  # the limits: 90 % within 6 mm, all within 15 mm
N_MEASURED = 20_000  # points a link and direction, at least
N_DENSE = 300_000  # points that stand for a surface when the nearest one is looked up
INNER_DEPTH_M = 1e-3  # mesh points deeper than this inside the convex parts are inner walls
SEAM_M = 1e-4  # neighbouring convex parts touch within this
FIT_POINTS, FIT_POINTS_PER_FACE, FIT_ROUNDS = 3_000, 250, 3


@dataclass
class Primitive:
    """A box (sizes x, y, z), a cylinder or capsule along z (radius, length) or a sphere (radius)."""

    kind: str
    xyz: np.ndarray
    rpy: np.ndarray
    size: np.ndarray

    def signed_distance(self, points):
        """Distance to the surface in m, negative inside; exact."""
        local = (points - self.xyz) @ Rotation.from_euler("xyz", self.rpy).as_matrix()
        if self.kind == "sphere":
            return np.linalg.norm(local, axis=1) - self.size[0]
        if self.kind == "capsule":
            half = self.size[1] / 2
            local[:, 2] -= np.clip(local[:, 2], -half, half)
            return np.linalg.norm(local, axis=1) - self.size[0]
        if self.kind == "cylinder":
            radial = np.hypot(local[:, 0], local[:, 1]) - self.size[0]
            excess = np.column_stack([radial, np.abs(local[:, 2]) - self.size[1] / 2])
        else:
            excess = np.abs(local) - self.size / 2
        return np.linalg.norm(np.maximum(excess, 0), axis=1) + np.minimum(excess.max(axis=1), 0)

    def faces(self):
        """Pairs of an area and a map from the unit square onto the face that keeps areas."""
        if self.kind == "box":
            for axis in range(3):
                others = np.delete(self.size, axis)
                for side in (-0.5, 0.5):
                    yield others.prod(), lambda u, v, axis=axis, side=side: self.size * np.insert(
                        np.column_stack([u, v]) - 0.5, axis, side, axis=1)
            return
        radius, length = self.size[0], self.size[1] if len(self.size) > 1 else 0.0
        turn = lambda u, r, z: np.column_stack(
            [r * np.cos(2 * np.pi * u), r * np.sin(2 * np.pi * u), z + 0 * u])
        if length:
            yield 2 * np.pi * radius * length, lambda u, v: turn(u, radius, (v - 0.5) * length)
        for end in (-1, 1):
            if self.kind == "cylinder":
                yield np.pi * radius**2, lambda u, v, end=end: turn(
                    u, radius * np.sqrt(v), end * length / 2)
            else:
                yield 2 * np.pi * radius**2, lambda u, v, end=end: turn(
                    u, radius * np.sqrt(1 - v**2), end * (length / 2 + radius * v))

    def surface(self, per_face=None, per_area=None):
        """Evenly spread points of the surface, and the area in m² that each stands for."""
        points, areas = [], []
        for area, place in self.faces():
            n = per_face or max(1, round(area * per_area))
            grid = np.outer(np.arange(n) + 0.5, [0.7548776662466927, 0.5698402909980532]) % 1
            points.append(place(*grid.T))
            areas.append(np.full(n, area / n))
        local = np.concatenate(points)
        return Rotation.from_euler("xyz", self.rpy).apply(local) + self.xyz, np.concatenate(areas)

    def rounded(self):
        """The same to 0.1 mm and 0.1 mrad, as it is written to the URDF."""
        return Primitive(self.kind, np.round(self.xyz, 4) + 0.0, np.round(self.rpy, 4) + 0.0,
                         np.round(self.size, 4))


@dataclass
class Seed:
    """Where a primitive starts, which pose coordinates (of "xyzrpw") may move, and its twin."""

    kind: str
    pose: tuple
    size: tuple
    free: str
    twin: bool = False  # a second one, mirrored at x = 0, goes with it


X, Y = (0, np.pi / 2, 0), (np.pi / 2, 0, 0)  # rpy that lays the axis of a cylinder along x or y
MESHES = {
    "Base_Link": "base_link",
    "Shoulder_Link": "shoulder_link",
    "HalfArm1_Link": "half_arm_1_link",
    "HalfArm2_Link": "half_arm_2_link",
    "ForeArm_Link": "forearm_link",
    "SphericalWrist1_Link": "spherical_wrist_1_link",
    "SphericalWrist2_Link": "spherical_wrist_2_link",
    "Bracelet_Link": "bracelet_no_vision_link",
}
# The Gen3's links are elbowed tubes, mirror-symmetric in x: a tube towards one joint, a drum
# across it at the other, a neck between them that is hollowed out on one side.
SEEDS = {
    "Base_Link": [
        Seed("cylinder", (0, 0, 0.085, 0, 0, 0), (0.046, 0.17), "z"),
        Seed("box", (-0.02, 0, 0.085, 0, 0, 0), (0.05, 0.06, 0.17), "xz"),
    ],
    "Shoulder_Link": [
        Seed("cylinder", (0, 0, -0.025, 0, 0, 0), (0.046, 0.045), "yz"),
        Seed("cylinder", (0, -0.012, -0.128, *Y), (0.046, 0.06), "yzr"),
        Seed("cylinder", (0, -0.016, -0.128, *Y), (0.038, 0.066), "yzr"),
        Seed("box", (0, -0.03, -0.07, 0, 0, 0), (0.07, 0.025, 0.06), "yzr"),
        Seed("capsule", (0, -0.01, -0.05, 0.6, 0, 0), (0.034, 0.02), "yzr"),
    ],
    "HalfArm1_Link": [
        Seed("cylinder", (0, -0.19, -0.006, *Y), (0.046, 0.07), "yzr"),
        Seed("cylinder", (0, 0, -0.025, 0, 0, 0), (0.046, 0.045), "yz"),
        Seed("cylinder", (0, 0, -0.03, 0, 0, 0), (0.038, 0.05), "yz"),
        Seed("capsule", (0, -0.13, -0.015, 1.3, 0, 0), (0.036, 0.06), "yzr"),
        Seed("box", (0, -0.07, -0.036, 0, 0, 0), (0.07, 0.08, 0.03), "yzr"),
    ],
    "HalfArm2_Link": [
        Seed("cylinder", (0, 0, -0.035, 0, 0, 0), (0.046, 0.04), "yzr"),
        Seed("cylinder", (0, -0.012, -0.21, *Y), (0.046, 0.06), "yz"),
        Seed("cylinder", (0, -0.016, -0.21, *Y), (0.038, 0.066), "yz"),
        Seed("capsule", (0, -0.012, -0.09, -0.2, 0, 0), (0.036, 0.06), "yzr"),
        Seed("box", (0, -0.03, -0.15, 0, 0, 0), (0.07, 0.03, 0.08), "yzr"),
    ],
    "ForeArm_Link": [
        Seed("cylinder", (0, -0.19, -0.006, *Y), (0.035, 0.06), "yzr"),
        Seed("cylinder", (0, 0, -0.025, 0, 0, 0), (0.046, 0.045), "yz"),
        Seed("cylinder", (0, 0, -0.03, 0, 0, 0), (0.038, 0.05), "yz"),
        Seed("capsule", (0, -0.13, -0.015, 1.3, 0, 0), (0.03, 0.06), "yzr"),
        Seed("box", (0, -0.07, -0.036, 0, 0, 0), (0.06, 0.08, 0.03), "yzr"),
    ],
    "SphericalWrist1_Link": [
        Seed("cylinder", (0, 0, -0.02, 0, 0, 0), (0.035, 0.035), "yz"),
        Seed("cylinder", (0, -0.018, -0.106, *Y), (0.035, 0.055), "yzr"),
        Seed("cylinder", (0, -0.02, -0.106, *Y), (0.028, 0.065), "yzr"),
        Seed("box", (0, -0.03, -0.06, 0, 0, 0), (0.055, 0.025, 0.05), "yzr"),
        Seed("capsule", (0, -0.01, -0.04, 0.6, 0, 0), (0.026, 0.02), "yzr"),
    ],
    "SphericalWrist2_Link": [
        Seed("cylinder", (0, -0.095, 0, *Y), (0.035, 0.045), "yzr"),
        Seed("cylinder", (0, 0, -0.022, 0, 0, 0), (0.035, 0.045), "yz"),
        Seed("cylinder", (0, 0, -0.028, 0, 0, 0), (0.028, 0.05), "yz"),
        Seed("box", (0, -0.04, -0.03, 0, 0, 0), (0.055, 0.06, 0.025), "yzr"),
        Seed("capsule", (0, -0.06, -0.012, 1.0, 0, 0), (0.026, 0.02), "yzr"),
    ],
    "Bracelet_Link": [
        Seed("cylinder", (0, 0, -0.038, 0, 0, 0), (0.0375, 0.053), "z"),
        Seed("cylinder", (0, 0, -0.02, 0, 0, 0), (0.033, 0.036), "z"),
    ],
}


def union_distance(primitives, points):
    """Smallest signed distance in m: exact outside the union, a lower bound of depth inside."""
    return np.min([p.signed_distance(points) for p in primitives], axis=0)


class RealLink:
    """The maker's geometry of one link: points of its surface, and which points are inside."""

    def __init__(self, robot_dir, mesh):
        arrays = np.load(robot_dir / "convex_parts.npz")
        parts = [arrays[name] for name in arrays if name.startswith(f"{mesh}/")]
        self._planes = [np.unique(ConvexHull(p).equations.round(9), axis=0) for p in parts]
        hulls = [trimesh.convex.convex_hull(p) for p in parts]
        n_per_area = N_DENSE / sum(h.area for h in hulls)
        outer = []
        for i, hull in enumerate(hulls):
            points = sample(hull, round(hull.area * n_per_area))
            others = self._planes[:i] + self._planes[i + 1:]
            outer.append(points[self._depth_bound(points, others) > SEAM_M])
        self.parts = np.concatenate(outer)
        self.raw = sample(trimesh.load(robot_dir / "meshes" / f"{mesh}.stl"), N_DENSE)
        self._parts_tree = cKDTree(self.parts)
        depth = -self.signed_distance(self.raw)
        self.mesh = self.raw[depth <= INNER_DEPTH_M]
        self.area = len(self.parts) / n_per_area

    @staticmethod
    def _depth_bound(points, planes):
        """Negative inside the union of the convex parts, else at most the distance to it."""
        nearest = np.full(len(points), np.inf)
        for part in planes:
            nearest = np.minimum(nearest, (points @ part[:, :3].T + part[:, 3]).max(axis=1))
        return nearest

    def signed_distance(self, points):
        """Distance in m to the outside of the convex parts, negative inside."""
        sign = np.concatenate([np.sign(self._depth_bound(chunk, self._planes))
                               for chunk in np.array_split(points, len(points) // 50_000 + 1)])
        return sign * self._parts_tree.query(points)[0]

    def baked_distance(self, spacing_m=0.0025, margin_m=0.03):
        """The signed distance as a quick interpolating function."""
        low = self.parts.min(axis=0) - margin_m
        shape = np.ceil((self.parts.max(axis=0) + margin_m - low) / spacing_m).astype(int) + 1
        nodes = low + spacing_m * np.indices(shape).reshape(3, -1).T
        grid = self.signed_distance(nodes).reshape(shape)
        return lambda points: map_coordinates(
            grid, (points - low).T / spacing_m, order=1, mode="nearest")


def sample(mesh, n):
    """Points of a mesh, uniform by area."""
    return trimesh.sample.sample_surface(mesh, n, seed=6)[0]


def outer_surface(primitives):
    """Points of the union's surface, uniform by area."""
    per_area = N_DENSE / sum(area for p in primitives for area, _ in p.faces())
    outer = []
    for i, primitive in enumerate(primitives):
        points = primitive.surface(per_area=per_area)[0]
        others = primitives[:i] + primitives[i + 1:]
        outer.append(points[union_distance(others, points) > 0] if others else points)
    return np.concatenate(outer)


def assemble(seeds, x):
    """The primitives that the free numbers `x` (m, rad) of the seeds stand for."""
    primitives, x = [], list(x)
    for seed in seeds:
        pose = np.array(seed.pose, float)
        for coordinate in seed.free:
            pose["xyzrpw".index(coordinate)] = x.pop(0)
        size = np.maximum(np.abs([x.pop(0) for _ in seed.size]), 1e-3)
        primitives.append(Primitive(seed.kind, pose[:3], pose[3:], size))
        if seed.twin:
            mirror = pose * (-1, 1, 1, 1, -1, -1)
            primitives.append(Primitive(seed.kind, mirror[:3], mirror[3:], size))
    return primitives


def start(seeds):
    """The free numbers of the seeds as they stand."""
    return np.concatenate([[*(s.pose["xyzrpw".index(c)] for c in s.free), *s.size] for s in seeds])


def fit(seeds, real, rng):
    """Primitives that least squares finds from the seeds, the best of a few jittered starts.

    Residuals are the signed distances of real points (two of `parts` for one of `mesh`) to the
    union, and those of our points to the real surface, weighted with the share of the area they
    stand for and faded out inside other primitives. Long distances count more than squared.
    """
    distance = real.baked_distance()
    target = np.concatenate([rng.choice(real.parts, 2 * FIT_POINTS // 3),
                             rng.choice(real.mesh, FIT_POINTS // 3)])
    stiffen = lambda d: d * np.sqrt(1 + (d / STIFFEN_M) ** 2)

    def residuals(x):
        primitives = assemble(seeds, x)
        parts = [stiffen(union_distance(primitives, target)) / np.sqrt(len(target))]
        for i, primitive in enumerate(primitives):
            points, areas = primitive.surface(per_face=FIT_POINTS_PER_FACE)
            others = primitives[:i] + primitives[i + 1:]
            outside = 1 / (1 + np.exp(-np.clip(union_distance(others, points) / FADE_M, -50, 50)))
            parts.append(np.sqrt(areas * outside / real.area) * stiffen(distance(points)))
        return np.concatenate(parts)

    results = []
    for round_ in range(FIT_ROUNDS):
        jittered = start(seeds) + (round_ > 0) * rng.normal(0, JITTER, len(start(seeds)))
        results.append(least_squares(residuals, jittered, max_nfev=60, diff_step=1e-4, x_scale=0.01))
    best = min(results, key=lambda r: r.cost)
    return [p.rounded() for p in assemble(seeds, best.x)]


def measure(primitives, real):
    """Distances in mm, by name: real points to our surface, our points to the real one."""
    ours = outer_surface(primitives)
    ours_tree, mesh_tree, parts_tree = cKDTree(ours), cKDTree(real.mesh), cKDTree(real.parts)

    def to_ours(points):
        signed = union_distance(primitives, points)
        return np.where(signed > 0, signed, ours_tree.query(points)[0])

    to_parts, nearest = parts_tree.query(ours)
    to_mesh = mesh_tree.query(ours)[0]
    closes_opening = mesh_tree.query(real.parts[nearest])[0] > OPENING_M
    distances = {
        "real>ours parts": to_ours(real.parts),
        "real>ours mesh": to_ours(real.mesh),
        "real>ours raw": to_ours(real.raw),
        "ours>real parts": to_parts,
        "ours>real mesh": np.where(closes_opening, to_parts, to_mesh),
    }
    return {name: 1e3 * d for name, d in distances.items()}
