"""The machine's axes: the tree of its URDF, and the pose of the spindle that they make."""
