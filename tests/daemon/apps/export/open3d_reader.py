"""Reads a cloud or mesh file with Open3D and writes what it found as npz; runs in an environment of its own.

Open3D brings another version of the thread library TBB, which numba refuses in the same process.

    python open3d_reader.py FILE OUT.npz
"""

import sys

import numpy as np
import open3d

given, out = sys.argv[1:]
if given.endswith((".glb", ".mesh.ply")):
    mesh = open3d.io.read_triangle_mesh(given)
    found = {"positions": mesh.vertices, "triangles": mesh.triangles, "normals": mesh.vertex_normals,
             "colors": mesh.vertex_colors}  # fmt: skip
else:
    found = {name: tensor.numpy() for name, tensor in open3d.t.io.read_point_cloud(given).point.items()}
np.savez(out, **{name: np.asarray(array) for name, array in found.items()})
