"""`diagnose` on the recordings of the arms, and the score of its reports."""
