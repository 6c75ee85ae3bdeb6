"""From residuals to a model: cells, fits, the search, and how sure its result is."""
