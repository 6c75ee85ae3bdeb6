"""How things touch: the definition that every engine, training and the bench share, and how deep shapes come to be in each other."""
