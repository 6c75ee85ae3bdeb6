"""The PhysX backend: the same robot in a second engine, which nothing is trained in and nothing is tuned to."""
