#!/usr/bin/env python3
"""Fits the collision primitives of the built-in Kinova Gen3, and measures how well they fit.

    fit_kinova_gen3.py ROBOT_DIR             fit, print the table
    fit_kinova_gen3.py ROBOT_DIR --write     fit, print, put the shapes into the URDF
    fit_kinova_gen3.py ROBOT_DIR --check     measure the shapes that stand in the URDF

ROBOT_DIR holds the maker's geometry, which is not part of this project: `meshes/*.stl` (open
shells) and `convex_parts.npz` (convex pieces, arrays "<mesh>/<i>" of vertices). Every mode exits
with 1 if a limit is broken, and takes `--picture FILE.png`. Needs numpy, scipy and trimesh, and
matplotlib for the picture. A fit takes about four minutes on one core, the same every time.

A link's surface is the surface of the union of its primitives. It is measured both ways, from
points of the real surface to ours and back, against three readings of the real one:

| column | real surface                                                                        |
|--------|-------------------------------------------------------------------------------------|
| parts  | the outside of the union of the convex pieces                                       |
| mesh   | the mesh without its inner walls; back, `parts` stands in where the shell is open   |
| raw    | the whole mesh: no solid can follow inner walls, so this one is printed, not judged |

Distances are to dense points of a surface, hence too long by up to half a millimetre, or exact
where a real point is outside our shapes. Lengths are in metres unless a name says otherwise;
everything is in the link's frame.
"""

import argparse
import re
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from scipy.ndimage import label, map_coordinates
from scipy.optimize import least_squares
from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.transform import Rotation
from scipy.special import expit

URDF = Path(__file__).resolve().parents[1] / "crates/palpate/src/robot/kinova_gen3.urdf"

NEAR_MM, NEAR_SHARE, FAR_MM = 6.0, 0.90, 15.0  # the limits: 90 % within 6 mm, all within 15 mm
N_DENSE = 300_000  # points that stand for a surface, before hidden ones are left out
N_MEASURED = 20_000  # at least so many of them must be left
INNER_DEPTH_M = 3e-3  # mesh points deeper than this inside the convex pieces are inner walls
OPENING_M = 5e-3  # surface of the convex pieces farther than this from the mesh closes an opening
SEAM_M = 1e-4  # neighbouring convex pieces touch within this

GRID_M, MARGIN_M = 2.5e-3, 0.03  # grid of the baked distance, and how far it reaches
AIR_M = 1e-3  # a grid node is air if at least so far from the convex pieces
SHUT_M = 4e-3  # a place farther than this from any air is a crack between the pieces
COPLANAR_M = 1e-6  # faces of two primitives that coincide are not hidden by each other
FIT_POINTS, FIT_POINTS_PER_FACE = 3_000, 250
FIT_EVALUATIONS = 60
STIFFEN_M = 0.01  # distances beyond this count with more than their square
FADE_M = 5e-4  # width over which our points fade out inside another primitive


@dataclass
class Primitive:
    """A box (sizes x, y, z), cylinder or capsule along z (radius, length), or sphere (radius)."""

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


X = (0, np.pi / 2, 0)  # rpy that lays the axis of a cylinder along x
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
# across it at the other, a neck between them that is hollowed out on one side. The seeds were grown
# once by adding to tube, drum and neck the shape that helped most, then rounded.
SEEDS = {
    "Base_Link": [
        Seed("cylinder", (0, 0, 0.085, 0, 0, 0), (0.046, 0.17), "z"),
        Seed("box", (-0.006, 0, 0.07, 0, 0, 0), (0.08, 0.063, 0.14), "xz"),
    ],
    "Shoulder_Link": [
        Seed("cylinder", (0, -0.001, -0.023, 0, 0, 0), (0.045, 0.042), "yz"),
        Seed("cylinder", (0, -0.01, -0.128, 1.57, 0, 0), (0.046, 0.058), "yzr"),
        Seed("cylinder", (0, -0.016, -0.13, -1.56, 0, 0), (0.036, 0.06), "yzr"),
        Seed("box", (0, -0.027, -0.073, -0.11, 0, 0), (0.088, 0.021, 0.077), "yzr"),
        Seed("capsule", (0, -0.02, -0.05, -0.73, 0, 0), (0.022, 0.016), "yzr"),
        Seed("box", (0, -0.035, -0.069, -1.63, 0, 0), (0.067, 0.069, 0.015), "yzr"),
        Seed("box", (0, -0.002, -0.042, -1.12, 0, 0), (0.08, 0.029, 0.049), "yzr"),
    ],
    "HalfArm1_Link": [
        Seed("cylinder", (0, -0.198, -0.006, 1.57, 0, 0), (0.046, 0.055), "yzr"),
        Seed("cylinder", (0, -0.001, -0.024, 0, 0, 0), (0.045, 0.043), "yz"),
        Seed("cylinder", (0, -0.001, -0.03, 0, 0, 0), (0.035, 0.045), "yz"),
        Seed("capsule", (0, -0.168, -0.01, 1.15, 0, 0), (0.041, 0.018), "yzr"),
        Seed("box", (0, -0.097, -0.03, -0.11, 0, 0), (0.073, 0.142, 0.023), "yzr"),
        Seed("box", (0, -0.103, -0.019, -0.41, 0, 0), (0.056, 0.066, 0.022), "yzr"),
        Seed("box", (0, -0.086, -0.04, -1.61, 0, 0), (0.051, 0.02, 0.112), "yzr"),
    ],
    "HalfArm2_Link": [
        Seed("cylinder", (0, -0.001, -0.033, 0, 0, 0), (0.045, 0.034), "yzr"),
        Seed("cylinder", (0, -0.008, -0.21, -1.57, 0, 0), (0.046, 0.057), "yz"),
        Seed("cylinder", (0, -0.012, -0.215, -1.57, 0, 0), (0.036, 0.065), "yz"),
        Seed("capsule", (0, -0.007, -0.056, -0.43, 0, 0), (0.039, 0.009), "yzr"),
        Seed("box", (0, -0.025, -0.133, -0.11, 0, 0), (0.072, 0.024, 0.132), "yzr"),
        Seed("cylinder", (0, -0.021, -0.101, *X), (0.023, 0.051), "yz"),
        Seed("box", (0, -0.034, -0.168, -1.62, 0, 0), (0.045, 0.126, 0.024), "yzr"),
    ],
    "ForeArm_Link": [
        Seed("cylinder", (0, -0.192, -0.007, 1.56, 0, 0), (0.035, 0.058), "yzr"),
        Seed("cylinder", (0, 0, -0.024, 0, 0, 0), (0.045, 0.043), "yz"),
        Seed("cylinder", (0, 0.003, -0.03, 0, 0, 0), (0.035, 0.047), "yz"),
        Seed("capsule", (0, -0.157, -0.01, 1.18, 0, 0), (0.031, 0.022), "yzr"),
        Seed("box", (0, -0.074, -0.035, -0.18, 0, 0), (0.059, 0.13, 0.02), "yzr"),
        Seed("box", (0, -0.075, -0.035, -0.13, 0, 0), (0.039, 0.081, 0.03), "yzr"),
        Seed("capsule", (0.022, -0.027, -0.039, 1.49, -0.13, 0), (0.015, 0.031), "xyzrp", twin=True),
    ],
    "SphericalWrist1_Link": [
        Seed("cylinder", (0, -0.001, -0.022, 0, 0, 0), (0.034, 0.038), "yz"),
        Seed("cylinder", (0, -0.013, -0.105, 1.56, 0, 0), (0.035, 0.05), "yzr"),
        Seed("cylinder", (0, -0.025, -0.105, -1.56, 0, 0), (0.03, 0.042), "yzr"),
        Seed("box", (0, -0.025, -0.065, -0.25, 0, 0), (0.062, 0.022, 0.064), "yzr"),
        Seed("sphere", (0, -0.008, -0.028, 0, 0, 0), (0.024,), "yz"),
        Seed("cylinder", (0, -0.032, -0.062, 1.35, 0, 0), (0.025, 0.015), "yzr"),
        Seed("cylinder", (0, -0.022, -0.108, *X), (0.03, 0.036), "yz"),
        Seed("cylinder", (0, -0.001, -0.042, 0.22, 0, 0), (0.026, 0.015), "yzr"),
    ],
    "SphericalWrist2_Link": [
        Seed("cylinder", (0, -0.092, -0.001, 1.55, 0, 0), (0.035, 0.053), "yzr"),
        Seed("cylinder", (0, 0, -0.021, 0, 0, 0), (0.034, 0.036), "yz"),
        Seed("cylinder", (0, 0.006, -0.027, 0, 0, 0), (0.024, 0.039), "yz"),
        Seed("box", (0, -0.05, -0.023, -0.47, 0, 0), (0.062, 0.049, 0.018), "yzr"),
        Seed("capsule", (0, -0.086, 0, 0.47, 0, 0), (0.032, 0.007), "yzr"),
        Seed("box", (0, -0.043, -0.032, -0.26, 0, 0), (0.045, 0.06, 0.016), "yzr"),
        Seed("capsule", (0.013, -0.007, -0.028, 1.45, 0.04, 0), (0.022, 0.017), "xyzrp", twin=True),
    ],
    "Bracelet_Link": [
        Seed("cylinder", (0, 0, -0.045, 0, 0, 0), (0.037, 0.039), "z"),
        Seed("cylinder", (0, 0, -0.028, 0, 0, 0), (0.034, 0.05), "z"),
    ],
}


def union_distance(primitives, points):
    """Smallest signed distance in m: exact outside the union, a lower bound of depth inside."""
    return np.min([p.signed_distance(points) for p in primitives], axis=0)


class RealLink:
    """The maker's geometry of one link: points of its surface, and which points are inside.

    The convex pieces enclose empty cavities, which nothing can touch: they count as inside.
    """

    def __init__(self, robot_dir, mesh):
        arrays = np.load(robot_dir / "convex_parts.npz")
        hulls = [ConvexHull(arrays[name]) for name in arrays if name.startswith(f"{mesh}/")]
        self._planes = [np.unique(hull.equations.round(9), axis=0) for hull in hulls]
        vertices = np.concatenate([hull.points for hull in hulls])
        self._bake_air(vertices.min(axis=0), vertices.max(axis=0))

        per_area = N_DENSE / sum(hull.area for hull in hulls)
        outer = []
        for i, hull in enumerate(hulls):
            points = sample(trimesh.convex.convex_hull(hull.points), round(hull.area * per_area))
            others = self._planes[:i] + self._planes[i + 1:]
            free = points[gap(points, others) > SEAM_M] if others else points
            outer.append(free[~self._in_cavity(free)])
        self.parts = np.concatenate(outer)
        self.area = len(self.parts) / per_area
        self._parts_tree = cKDTree(self.parts)

        self.raw = sample(trimesh.load(robot_dir / "meshes" / f"{mesh}.stl"), N_DENSE)
        self.mesh = self.raw[self.signed_distance(self.raw) >= -INNER_DEPTH_M]

    def _bake_air(self, low, high):
        """Finds the nodes of a grid that are in air, and those of them that no path leads to."""
        self._low = low - MARGIN_M
        self._shape = np.ceil((high + MARGIN_M - self._low) / GRID_M).astype(int) + 1
        self._nodes = self._low + GRID_M * np.indices(self._shape).reshape(3, -1).T
        free = gap(self._nodes, self._planes) > AIR_M
        region = label(free.reshape(self._shape))[0].ravel()
        self._air_tree = cKDTree(self._nodes[free])
        self._is_cavity = region[free] != region[0]

    def _in_cavity(self, points):
        """Whether the air nearest to a point is enclosed, or too far: in a crack."""
        distance, nearest = self._air_tree.query(points)
        return self._is_cavity[nearest] | (distance > SHUT_M)

    def signed_distance(self, points):
        """Distance in m to the outside of the convex pieces, negative inside."""
        inside = (gap(points, self._planes) < SEAM_M) | self._in_cavity(points)
        return np.where(inside, -1, 1) * self._parts_tree.query(points)[0]

    def baked_distance(self):
        """The signed distance as a quick interpolating function."""
        grid = self.signed_distance(self._nodes).reshape(self._shape)
        return lambda points: map_coordinates(
            grid, (points - self._low).T / GRID_M, order=1, mode="nearest")


def gap(points, convexes):
    """Negative inside the union of convex pieces, else at most the distance to it in m."""
    nearest = np.full(len(points), np.inf)
    for planes in convexes:
        for chunk in np.array_split(np.arange(len(points)), len(points) // 50_000 + 1):
            reach = (points[chunk] @ planes[:, :3].T + planes[:, 3]).max(axis=1)
            nearest[chunk] = np.minimum(nearest[chunk], reach)
    return nearest


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
        outer.append(points[union_distance(others, points) > -COPLANAR_M] if others else points)
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


def fit(seeds, real):
    """The primitives that least squares finds from the seeds.

    Residuals are the signed distances of real points (two of `parts` for one of `mesh`) to the
    union, and those of our points to the real surface, weighted with the share of the area they
    stand for and faded out inside other primitives.
    """
    rng = np.random.default_rng(6)
    distance = real.baked_distance()
    target = np.concatenate([rng.choice(real.parts, 2 * FIT_POINTS // 3),
                             rng.choice(real.mesh, FIT_POINTS // 3)])
    stiffen = lambda d: d * np.sqrt(1 + (d / STIFFEN_M) ** 2)

    def residuals(x):
        primitives = assemble(seeds, x)
        apart = [stiffen(union_distance(primitives, target)) / np.sqrt(len(target))]
        for i, primitive in enumerate(primitives):
            points, areas = primitive.surface(per_face=FIT_POINTS_PER_FACE)
            others = primitives[:i] + primitives[i + 1:]
            outside = expit(union_distance(others, points) / FADE_M)
            apart.append(np.sqrt(areas * outside / real.area) * stiffen(distance(points)))
        return np.concatenate(apart)

    found = least_squares(
        residuals, start(seeds), max_nfev=FIT_EVALUATIONS, diff_step=1e-4, x_scale=0.01)
    return [p.rounded() for p in assemble(seeds, found.x)]


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
    for name, d in distances.items():
        assert len(d) >= N_MEASURED, f"{name}: only {len(d)} points"
    return {name: 1e3 * d for name, d in distances.items()}


def report(measured, areas_m2):
    """Prints a row a link and one for all, weighted by area; returns what breaks a limit."""
    columns = list(next(iter(measured.values()))[1])
    print("each: % within 6 mm, largest mm, root mean square mm")
    print(f"{'link':21}{'n':>3}" + "".join(f"{c:>22}" for c in columns))
    broken, rows = [], []
    for link, (primitives, distances) in measured.items():
        row = [(np.mean(d <= NEAR_MM), d.max(), np.mean(d**2)) for d in distances.values()]
        rows.append(row)
        print_row(link, len(primitives), row)
        broken += [f"{link}, {column}" for column, (share, largest, _) in zip(columns, row)
                   if "raw" not in column and (share < NEAR_SHARE or largest > FAR_MM)]
    rows = np.array(rows)
    mean = np.average(rows, axis=0, weights=areas_m2)
    mean[:, 1] = rows[:, :, 1].max(axis=0)
    print_row("all", sum(len(p) for p, _ in measured.values()), mean)
    return broken


def print_row(name, count, row):
    """Prints one row of the table from shares, largest and mean squared distances."""
    cells = (f"{100 * near:.1f} {largest:5.1f} {square**0.5:5.2f}" for near, largest, square in row)
    print(f"{name:21}{count:3}" + "".join(f"{cell:>22}" for cell in cells), flush=True)


SIZES = {"box": ["size"], "sphere": ["radius"], "cylinder": ["radius", "length"],
         "capsule": ["radius", "length"]}


def read_shapes(urdf, link):
    """The primitives of a link that stand in the text of the URDF."""
    shapes = []
    numbers = lambda text: np.array(text.split(), float)
    robot = ElementTree.fromstring(urdf.encode())
    for collision in robot.findall(f"link[@name='{link}']/collision"):
        origin, shape = collision.find("origin"), collision.find("geometry")[0]
        size = numbers(" ".join(shape.get(name) for name in SIZES[shape.tag]))
        shapes.append(
            Primitive(shape.tag, numbers(origin.get("xyz")), numbers(origin.get("rpy")), size))
    return shapes


def with_shapes(urdf, link, primitives):
    """The text of the URDF with the link's collision elements replaced."""
    text = lambda numbers: " ".join(f"{n:g}" for n in numbers)
    elements = ""
    for p in primitives:
        size = [text(p.size)] if p.kind == "box" else map("{:g}".format, p.size)
        size = " ".join(f'{name}="{n}"' for name, n in zip(SIZES[p.kind], size))
        elements += (f'    <collision>\n      <origin xyz="{text(p.xyz)}" rpy="{text(p.rpy)}" />\n'
                     f"      <geometry><{p.kind} {size} /></geometry>\n    </collision>\n")
    start = urdf.index(f'<link name="{link}">')
    end = urdf.index("  </link>", start)
    kept = re.sub(r" *<collision>.*?</collision>\n", "", urdf[start:end], flags=re.DOTALL)
    return urdf[:start] + kept + elements + urdf[end:]


def draw(measured, reals, path):
    """A picture with a column a link: real surface red, ours blue, in silhouette and in slices."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5 * len(measured), 16), layout="constrained")
    for axes, (link, (primitives, _)) in zip(figure.subplots(3, len(measured)).T, measured.items()):
        middle = (reals[link].parts.min(axis=0) + reals[link].parts.max(axis=0)) / 2
        for ax, (across, up, depth) in zip(axes, [(1, 2, 0), (0, 2, 1), (0, 1, 2)]):
            for points, colour in [(reals[link].parts, "red"), (outer_surface(primitives), "blue")]:
                ax.plot(*points[::10, [across, up]].T, ",", color=colour, alpha=0.15)
                at = middle[depth] if depth else 0
                sliced = points[np.abs(points[:, depth] - at) < 1e-3]
                ax.plot(*sliced[:, [across, up]].T, ".", color=colour, markersize=2)
            ax.set(aspect="equal", title=f"{link} {'xyz'[across]}{'xyz'[up]}")
    figure.savefig(path, dpi=50)


def main():
    """Fits or reads, measures, reports, and writes what was asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robot_dir", type=Path)
    parser.add_argument("--picture", type=Path)
    mode = parser.add_mutually_exclusive_group()
    mode.add_argument("--write", action="store_true")
    mode.add_argument("--check", action="store_true")
    arguments = parser.parse_args()

    urdf = URDF.read_text()
    measured, reals = {}, {}
    for link, mesh in MESHES.items():
        real = reals[link] = RealLink(arguments.robot_dir, mesh)
        shapes = read_shapes(urdf, link) if arguments.check else fit(SEEDS[link], real)
        if not shapes:
            sys.exit(f"{URDF.name}: link `{link}` has no collision shapes; run with --write")
        measured[link] = shapes, measure(shapes, real)
        urdf = with_shapes(urdf, link, shapes)

    broken = report(measured, [real.area for real in reals.values()])
    if arguments.picture:
        draw(measured, reals, arguments.picture)
    if arguments.write:
        URDF.write_text(urdf)
    if broken:
        sys.exit("limits broken: " + "; ".join(broken))


if __name__ == "__main__":
    main()
