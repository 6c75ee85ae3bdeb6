"""The gap doctor: where the arm departs from the nominal simulator, which effect explains it, how far the gap shrinks."""
