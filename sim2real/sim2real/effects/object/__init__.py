"""What the object is, other than it is believed to be."""
