"""The contact definition that engines, training and bench share, and penetration depths."""
