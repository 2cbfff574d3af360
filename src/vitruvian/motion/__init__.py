"""Motions: clips of joint rotations, our own gaits, retargeting."""
