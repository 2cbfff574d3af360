"""The standard: names, tables, the Humanoid tree, the scene graph, the doctor. No maths."""
