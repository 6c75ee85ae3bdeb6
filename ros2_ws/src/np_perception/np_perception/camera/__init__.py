"""The camera: what a node needs of one, recordings in its place, lens and clock."""
