"""Cases of arms: faults, background and their sizes, drawn from a seed and the case number."""
