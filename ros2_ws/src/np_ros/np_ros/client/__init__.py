"""Who looks at a graph and asks it: nodes in a command's own process."""
