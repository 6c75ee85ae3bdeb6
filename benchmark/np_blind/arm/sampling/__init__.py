"""What a case of an arm is: faults, background, and their sizes, from a seed and the case's number."""
