"""The diagnosis of the gap: where the arm departs from its simulator, which effect explains it, how far it shrinks."""
