"""Episodes of trained policies, and recordings of them."""
