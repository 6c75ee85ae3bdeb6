"""The excitation suite, and which experiment next."""
