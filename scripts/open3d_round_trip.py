#!/usr/bin/env python3
"""Holds palpate's clouds and cameras against Open3D, in both directions.

    open3d_round_trip.py                writes what Open3D writes into crates/palpate-io/testdata/open3d,
                                        for tests/open3d.rs to read
    open3d_round_trip.py --check DIR    reads palpate.ply and palpate.pcd in DIR, as tests/open3d.rs
                                        wrote them, and asserts that nothing was lost

Made with Open3D 0.20 and numpy 2.4.6; the files hold 50 points each.
"""

import json
import sys
from pathlib import Path

import numpy as np
import open3d as o3d

FIXTURES = Path(__file__).parents[1] / "crates" / "palpate-io" / "testdata" / "open3d"
POINTS, WIDTH, HEIGHT = 50, 640, 480
FX, FY, CX, CY = 579.25, 580.5, 319.5, 239.25


def expected():
    rng = np.random.default_rng(5)
    points = rng.uniform(-1.0, 1.0, (POINTS, 3)) + [0.5, 0.0, 0.7]
    colours = rng.integers(0, 256, (POINTS, 3)).astype(np.uint8)
    rotation = o3d.geometry.get_rotation_matrix_from_xyz([2.0, -0.3, 0.9])
    camera_to_world = np.eye(4)
    camera_to_world[:3, :3], camera_to_world[:3, 3] = rotation, [-0.33, -0.58, 0.86]
    return points, colours, camera_to_world


def write():
    FIXTURES.mkdir(parents=True, exist_ok=True)
    points, colours, camera_to_world = expected()

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.colors = o3d.utility.Vector3dVector(colours / 255.0)
    cloud.normals = o3d.utility.Vector3dVector(np.tile([0.0, 0.0, 1.0], (POINTS, 1)))
    for name, options in {
        "text": {"write_ascii": True},
        "binary": {},
        "compressed": {"compressed": True},
    }.items():
        for ending in ["ply", "pcd"]:
            if (name, ending) != ("compressed", "ply"):
                assert o3d.io.write_point_cloud(str(FIXTURES / f"{name}.{ending}"), cloud, **options)

    tensor = o3d.t.geometry.PointCloud(o3d.core.Tensor(points.astype(np.float32)))
    tensor.point.colors = o3d.core.Tensor(colours)
    tensor.point.K = o3d.core.Tensor(np.ones((POINTS, 1)))
    for ending in ["ply", "pcd"]:
        assert o3d.t.io.write_point_cloud(str(FIXTURES / f"tensor.{ending}"), tensor)

    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(points),
        o3d.utility.Vector3iVector(np.arange(48).reshape(16, 3)),
    )
    mesh.vertex_colors = o3d.utility.Vector3dVector(colours / 255.0)
    assert o3d.io.write_triangle_mesh(str(FIXTURES / "mesh.ply"), mesh)

    intrinsic = o3d.camera.PinholeCameraIntrinsic(WIDTH, HEIGHT, FX, FY, CX, CY)
    parameters = o3d.camera.PinholeCameraParameters()
    parameters.intrinsic, parameters.extrinsic = intrinsic, np.linalg.inv(camera_to_world)
    assert o3d.io.write_pinhole_camera_intrinsic(str(FIXTURES / "intrinsic.json"), intrinsic)
    assert o3d.io.write_pinhole_camera_parameters(str(FIXTURES / "parameters.json"), parameters)

    # Left half red, right half blue, for JPEG keeps no single pixel.
    picture = np.zeros((16, 32, 3), dtype=np.uint8)
    picture[:, :16, 0], picture[:, 16:, 2] = 250, 200
    assert o3d.io.write_image(str(FIXTURES / "halves.jpg"), o3d.geometry.Image(picture), 95)

    fixture = {
        "points": points.tolist(),
        "colours": colours.tolist(),
        "camera_to_world": camera_to_world.tolist(),
        "width": WIDTH,
        "height": HEIGHT,
        "focal": [FX, FY],
        "centre": [CX, CY],
    }
    (FIXTURES / "expected.json").write_text(json.dumps(fixture, indent=1) + "\n")
    print(f"written to {FIXTURES.name}: {sorted(path.name for path in FIXTURES.iterdir())}")


def check(folder):
    points, colours, _ = expected()
    stiffness, deviation = 10.0 + np.arange(POINTS), 0.25 * np.arange(POINTS)
    touched = np.arange(POINTS) % 2
    # PLY keeps coordinates to the last bit, PCD rounds them to 32 bits.
    for name, wanted in {"palpate.ply": points, "palpate.pcd": points.astype(np.float32)}.items():
        path = str(folder / name)
        cloud = o3d.io.read_point_cloud(path)
        assert np.array_equal(np.asarray(cloud.points), wanted), name
        assert np.array_equal(np.rint(255.0 * np.asarray(cloud.colors)), colours), name
        tensor = o3d.t.io.read_point_cloud(path).point
        assert np.array_equal(tensor.positions.numpy(), wanted), name
        assert np.array_equal(tensor.colors.numpy(), colours), name
        assert np.array_equal(tensor.K.numpy().ravel(), stiffness), name
        assert np.array_equal(tensor.K_std.numpy().ravel(), deviation), name
        assert np.array_equal(tensor.touched.numpy().ravel(), touched), name
        print(f"Open3D reads {name} as it was written: {len(wanted)} points, colours, 3 columns")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--check"]:
        check(Path(sys.argv[2]))
    else:
        write()
