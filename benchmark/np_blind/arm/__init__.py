"""Arms with sealed causes: cases, recordings, and the score of `diagnose`."""
