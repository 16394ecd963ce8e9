"""Opens what `palpate convert` makes of a field with programs that are not palpate's, and compares it with the field.

    exports.py FIELD.npz FOLDER

FOLDER holds field.vti (PyVista), field.glb (trimesh), boxes.urdf (MuJoCo), springs.xml (MuJoCo) and stiff.ply (trimesh),
the last three of the cells above a stiffness that stiff.npz has. Each is compared number by number. Libraries:
requirements.txt, pinned.
"""

import sys
from pathlib import Path

import mujoco
import numpy as np
import pyvista
import trimesh


def image(path, field):
    """Each point of the image has the stiffness of its cell, or none."""
    grid = pyvista.read(path)
    found = {tuple(np.round(p, 5)): k for p, k, n in zip(grid.points, grid["K"], grid["N_obs"]) if n > 0}
    wanted = {tuple(np.round(p, 5)): k for p, k, n in zip(field["points"], field["K"], field["N_obs"]) if n > 0}
    assert found.keys() == wanted.keys(), (len(found), len(wanted))
    assert all(abs(found[place] - k) <= 1e-6 * max(k, 1) for place, k in wanted.items())
    print(f"{path.name}: {len(found)} cells")


def scene(path, field):
    """The field's octahedra are around cells of the field, and the arm is there, link by link."""
    loaded = trimesh.load(path, process=False)
    turned = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # their y is our z
    shapes = {name: shape for name, shape in loaded.geometry.items()}
    cells = shapes.pop("field")
    transform, _ = loaded.graph["field"]
    centres = trimesh.transform_points(cells.vertices.reshape(-1, 24, 3).mean(axis=1), transform) @ turned.T
    distance = np.linalg.norm(centres[:, None] - field["points"][None], axis=2).min(axis=1)
    assert distance.max() < 1e-5, distance.max()
    assert len(shapes) >= 7 and all(shape.is_watertight and shape.volume > 0 for shape in shapes.values()), shapes
    colours = cells.visual.vertex_attributes["color"]
    assert len(np.unique(colours, axis=0)) > 10
    print(f"{path.name}: {len(centres)} cells, {len(shapes)} links")


def boxes(path, stiff):
    """Each stiff cell is in just one box, and the boxes have the volume of the cells."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    solid = np.flatnonzero(model.geom_contype > 0)
    centre, half = data.geom_xpos[solid], model.geom_size[solid]
    inside = (np.abs(stiff["points"][:, None] - centre[None]) < half[None]).all(axis=2).sum(axis=1)
    assert (inside == 1).all(), np.unique(inside)
    spacing = stiff["lattice"][3]
    volume = (2 * half).prod(axis=1).sum()
    assert abs(volume / (len(stiff["points"]) * spacing**3) - 1) < 1e-3, volume
    print(f"{path.name}: {len(solid)} boxes, {len(stiff['points'])} cells")


def springs(path, stiff):
    """A force on a ball moves it by force over stiffness, whichever way; without one it stays."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    stiffness = model.jnt_stiffness.reshape(-1, 3)
    stiffness = stiffness[:, :, 0] if stiffness.ndim == 3 else stiffness
    assert np.isclose(stiffness[:, 0].sum(), stiff["K"].sum(), rtol=1e-6)
    still = 1 + np.argmin(stiffness[:, 0])
    pushed = 1 + np.argmax(stiffness[:, 0])
    force = np.array([3.0, -2.0, 1.0])
    data.xfrc_applied[pushed, :3] = force
    for _ in range(2000):
        mujoco.mj_step(model, data)
    moved = data.qpos.reshape(-1, 3)
    assert np.allclose(moved[pushed - 1], force / stiffness[pushed - 1], rtol=1e-3), moved[pushed - 1]
    assert np.abs(moved[still - 1]).max() < 1e-9
    print(f"{path.name}: {len(stiffness)} points on springs")


def cloud(path, stiff):
    """The cloud has the stiff cells alone."""
    found = trimesh.load(path).vertices
    assert np.allclose(found, stiff["points"], atol=1e-6)
    print(f"{path.name}: {len(found)} points")


def main():
    field, folder = np.load(sys.argv[1]), Path(sys.argv[2])
    stiff = np.load(folder / "stiff.npz")
    image(folder / "field.vti", field)
    scene(folder / "field.glb", field)
    boxes(folder / "boxes.urdf", stiff)
    springs(folder / "springs.xml", stiff)
    cloud(folder / "stiff.ply", stiff)


if __name__ == "__main__":
    main()
