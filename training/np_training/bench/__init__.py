"""How fast training is, against the bare physics."""
