"""Deformation: joint matrices to vertices, normals and per-vertex frames."""
