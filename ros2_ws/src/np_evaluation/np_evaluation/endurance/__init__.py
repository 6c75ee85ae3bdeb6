"""What a graph has to stand: many episodes, and messages that nobody should send."""
