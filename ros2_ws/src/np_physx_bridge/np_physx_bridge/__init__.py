"""The PhysX backend: the same robot in a second engine, developed beside the policies and frozen now (`engine.VERSION`).

No gradient was taken in it; changes of it were begun by tasks that failed in it, and each has a test against theory.
"""
