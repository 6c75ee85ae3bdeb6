"""A controller that is not the one it should be. Shows in the replayed law."""
