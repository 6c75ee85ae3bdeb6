"""The PhysX backend: the same robot in a second engine, developed beside the policies and frozen now (`engine.VERSION`).

No gradient was taken in it; until 2026-11-26 its mends were begun by tasks that failed in it.
"""
