"""Files of trained weights: where they lie, their header, and the contract that stands in it. No PyTorch."""
