"""From residuals to structures: cells, fits, the search, and how sure its answer is."""
