#!/usr/bin/env python3
"""Checks with trimesh that mesh files contain closed surfaces: closed.py FILE ..."""
import sys

import trimesh

failed = 0
for path in sys.argv[1:]:
    loaded = trimesh.load(path)
    meshes = list(loaded.geometry.values()) if isinstance(loaded, trimesh.Scene) else [loaded]
    for mesh in meshes:
        if not (mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0):
            print(f"{path}: watertight {mesh.is_watertight}, winding {mesh.is_winding_consistent}, volume {mesh.volume}")
            failed += 1
    if path.endswith((".glb", ".ply")):
        for mesh in meshes:
            # for a glTF mesh with a material, trimesh keeps them as a vertex attribute
            visual = mesh.visual
            colors = visual.vertex_colors if visual.kind == "vertex" else visual.vertex_attributes.get("color")
            if colors is None or len(colors) != len(mesh.vertices):
                print(f"{path}: colors are missing")
                failed += 1
print(f"{len(sys.argv) - 1} files, {failed} surfaces that are not closed")
sys.exit(failed > 0)
