"""What others make of the chain's cases: each has `ask`, and says what it found and how it predicts."""
