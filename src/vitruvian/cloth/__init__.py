"""Garments: patterns, fabrics, the tailor and the solver. Arrays only, no files."""
