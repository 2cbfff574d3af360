"""Making bodies: the built-in person."""
