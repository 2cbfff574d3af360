"""The packed form of a humanoid: arrays, and forward kinematics on them."""
