"""Files: one module per format, one registry keyed by extension."""
