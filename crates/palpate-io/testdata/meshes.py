"""Writes the same box (2 x 1 x 3, one corner at the origin) as binary STL, text STL and OBJ.

`boxes.dae` is written by hand: two instances of the same box as quads in millimetres, the second
rotated by 90 degrees about z and moved by 10 m along x, and a geometry that is not in the scene.
"""

import struct
from pathlib import Path

HERE = Path(__file__).parent
VERTICES = [(x, y, z) for z in (0, 3) for y in (0, 1) for x in (0, 2)]
QUADS = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
TRIANGLES = [t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))]

stl = b"box, binary".ljust(80) + struct.pack("<I", len(TRIANGLES))
for triangle in TRIANGLES:
    corners = [number for corner in triangle for number in VERTICES[corner]]
    stl += struct.pack("<12fH", 0, 0, 0, *corners, 0)
(HERE / "box.stl").write_bytes(stl)

text = "solid box\n"
for triangle in TRIANGLES:
    text += "facet normal 0 0 0\n outer loop\n"
    text += "".join(f"  vertex {x} {y} {z}\n" for x, y, z in (VERTICES[i] for i in triangle))
    text += " endloop\nendfacet\n"
(HERE / "box_text.stl").write_text(text + "endsolid box\n")

obj = "mtllib nowhere.mtl\no box\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in VERTICES)
obj += "vt 0 0\nvn 0 0 1\nusemtl steel\n"
obj += "".join("f " + " ".join(f"{i + 1}/1/1" for i in quad) + "\n" for quad in QUADS[:3])
obj += "usemtl tin\n" + "".join("f " + " ".join(f"{i - 8}" for i in quad) + "\n" for quad in QUADS[3:])
(HERE / "box.obj").write_text(obj)
