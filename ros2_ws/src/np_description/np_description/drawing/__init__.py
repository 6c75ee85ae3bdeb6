"""The scene for those who draw it: meshes, a URDF, shapes and moments as data."""
